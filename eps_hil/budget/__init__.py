"""Where the estimate's error comes from: by simulation, source by source."""
