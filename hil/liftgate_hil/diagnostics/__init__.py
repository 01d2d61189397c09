"""Diagnostics on the bus: ISO-TP, the bench's tester, trouble codes, and decoding of UDS responses."""
