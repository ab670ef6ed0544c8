"""What the rig obeys: pure functions and frozen values, no I/O."""
