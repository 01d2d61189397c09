"""The plant's step as C, translated from its Python source, to measure the compiled step against.

`translate` makes C99 of the functions, `build` a library of it and the comparison: python -m tools.twin.
"""
