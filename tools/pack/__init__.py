"""What the shipped pack of scenarios is worth: its verdicts and margins, and the mutants that it finds."""
