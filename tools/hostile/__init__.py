"""Robustness campaign against the command line: mangled files, and signals at random moments."""
