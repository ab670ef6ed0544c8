"""Somebody's simulator in the place of our model: its traces aligned, and reduced to a model."""
