"""The terminal: results on stdout; on stderr messages, and below them pictures of progress."""
