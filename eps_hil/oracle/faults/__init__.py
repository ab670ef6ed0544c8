"""Faults on the bus, in nodes and service, and what each does to a published estimate."""
