"""Live page of a rig and the service on its bus, and of recordings: read-only, in a browser."""
