"""A simulated rig and ECU that speak CAN."""
