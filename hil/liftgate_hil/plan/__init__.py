"""Plans of runs: a run as it is requested, and all that it needs, made once and checked."""
