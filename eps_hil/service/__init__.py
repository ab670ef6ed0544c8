"""The asynchronous 1 kHz service."""
