"""Measurements: read from files of many kinds, cut, thinned out, checked."""
