"""From aligned signals to a rack force: alignment, friction compensation, observer."""
