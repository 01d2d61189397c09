"""Search for the smallest margin: well-spread points, a surrogate, and descents of cma."""
