"""Grey-box identification: which plant parameters a measurement determines, how well, and the best experiment."""
