"""Measurements of known truth, and what identification makes of them: `python -m tools.identification --help`."""
