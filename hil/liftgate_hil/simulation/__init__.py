"""Offline simulation of the plant alone, as a command and as a function."""
