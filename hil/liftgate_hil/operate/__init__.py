"""What acts on a run while it goes on: faults, requests and signals, from a test bench or an operator."""
