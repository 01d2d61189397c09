"""Runs of a scenario against an ECU: the drivers of all clocks, and the gate that a caller steps."""
