"""Recordings of any format, read into canonical signals."""
