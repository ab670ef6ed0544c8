"""What touches a CAN bus or its description: ports, codec, mapping, end-to-end protection."""
