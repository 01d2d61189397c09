"""Stimuli of a run: influences on the gate over time, and the driver's requests to the ECU."""
