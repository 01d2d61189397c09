"""Scenarios as tests: collected, run, judged, reported; and the pytest plugin."""
