"""What is expected of a run, and what came of it."""
