"""The plant's step as C, translated from its Python source, to measure the compiled step against.

`translate` makes C99 of a function and all that it calls, with `statements`, `expressions`, `values` and `names`
each for its part; `build` makes a library of it and compares the two, as a section of the benchmark.
`python -m tools.c_translator` prints the C.
"""
