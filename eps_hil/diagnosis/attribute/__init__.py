"""Which names explain it: candidates scored, selected, exchanged, and the model's own numbers."""
