"""Whether recordings that took no part confirm it: before and after, ablations, placebos."""
