"""Functional Mock-up Units (FMI): the model as one, and somebody's simulator as one."""
