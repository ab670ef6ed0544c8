"""Whether recordings that took no part bear it out: before and after, ablations, placebos."""
