"""The figures of `plot`, a file each: `draw(subject)` of it returns the figure. `catalogue.py` is their table."""
