"""The figures of `plot`, a file each: `draw(subject)` of it returns the figure. `request.FIGURES` lists them."""
