"""Expectations of a run, the judge that evaluates them, and their verdicts."""
