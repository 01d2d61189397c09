"""Output on the terminal: results on stdout; messages on stderr, and below them the display of progress."""
