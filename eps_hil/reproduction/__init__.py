"""The seed paper's figures and table, made anew on the simulated rig, and judged in numbers."""
