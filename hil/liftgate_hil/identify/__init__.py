"""The grey box: which parameters of the plant a measurement tells, how well, and by which experiment best."""
