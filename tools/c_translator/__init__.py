"""Translation of the plant's step from its Python source to C, to measure the compiled step against.

`translate` makes C99 of a function and all that it calls; `statements`, `expressions`, `values` and `names` each
do a part of that. `build` makes a library of the C code and compares the two, as a section of the benchmark.
`python -m tools.c_translator` prints the C code.
"""
