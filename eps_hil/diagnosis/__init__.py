"""From a mismatch to the physics that was left out: quality, locate, attribute, accept, verdict."""
