"""Is this PC good enough for a 1 kHz rig: what was measured, the limit, and what to change."""
