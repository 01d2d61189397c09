"""Recordings into other formats, drawn, and compared."""
