"""Scenario files as tests: collect, run, judge and report them; and the pytest plugin."""
