"""Scenarios as tests: found, run, judged, reported; and pytest's plugin."""
