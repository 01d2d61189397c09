"""The figures of `plot`, one per module, whose `draw(subject)` returns it; `request.FIGURES` lists them."""
