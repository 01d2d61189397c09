"""Expectations of a run, and their verdicts."""
