"""Operation of a running gate: faults, requests and signals from a test bench or an operator."""
