"""Measurements: read from files of many formats, cut, decimated, checked."""
