"""Stimuli that act on the gate, and the driver's requests to the ECU."""
