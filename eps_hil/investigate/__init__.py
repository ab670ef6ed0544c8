"""A rig that finds out by itself: experiments chosen, run and judged until nothing is open."""
