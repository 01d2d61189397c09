"""Plans of runs: a requested run with everything that it needs, prepared once and validated."""
