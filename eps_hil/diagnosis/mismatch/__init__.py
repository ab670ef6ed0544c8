"""The mismatch itself: where it sits, its curve over a coordinate, and what is left of it."""
