"""Identification: a rig's parameters and responses from its recordings."""
