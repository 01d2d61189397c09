"""The physics of a power lift gate, after F. Boberg (Linköping 2008).

Read `dynamics` first: it assembles the bodies. `integrate` steps them. The other files describe one body of the
gate each: its parameters and its functions. No physics in here does I/O, reads a clock or keeps state.

Units: SI, radians, motor speed in rev/s and motor position in rev. Positive opens.
"""
