"""The operator's page of a run or of a recording: a process of its own, with a web server."""
