"""Benchmarks: python -m tools.benchmark. Nothing here passes or fails; ratios are measured side by side."""
