"""The physics of a power lift gate, after F. Boberg (Linköping 2008).

Read `dynamics` first: it puts the bodies together. `integrate` steps them. Every other file is one body
of the gate: its parameters and its functions. Nothing in here does I/O, knows a clock or keeps state.

Units: SI, radians, motor speed in rev/s and motor position in rev. Positive opens.
"""
