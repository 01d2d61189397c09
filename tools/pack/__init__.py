"""Evaluation of the shipped pack of scenarios: its verdicts and margins, and the mutants that it finds."""
