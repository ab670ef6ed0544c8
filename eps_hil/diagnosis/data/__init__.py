"""The recordings: fit for a diagnosis or not, what their channels are, made ready for it."""
