"""What acts on the gate from outside, and what the driver asks of the ECU."""
