"""Accuracy study of the plant's step of 1 ms, on vehicles and phases drawn at random."""
