"""Runs of a scenario against an ECU."""
