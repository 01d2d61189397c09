"""Recordings converted into other formats, plotted, and compared."""
