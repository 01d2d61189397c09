"""Recordings: one file a format behind `Recorder`; the suffix picks it."""
