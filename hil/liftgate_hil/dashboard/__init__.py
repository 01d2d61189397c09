"""Operator's page of a run or of a recording: a web server in a process of its own."""
