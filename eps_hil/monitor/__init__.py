"""Terminal view of a rig and the service on its bus, and of where rig and model part."""
