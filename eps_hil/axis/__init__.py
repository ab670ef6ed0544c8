"""A linear axis seen as a steering rig: one mass, one drive, a force that nobody measured."""
