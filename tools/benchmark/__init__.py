"""Benchmarks of the project: python -m tools.benchmark. They measure ratios side by side; none passes or fails."""
