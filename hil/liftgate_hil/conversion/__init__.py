"""Conversion of recordings into other formats, their plots, and comparison of two recordings."""
