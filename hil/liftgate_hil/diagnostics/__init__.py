"""Diagnostics on the bus: transport protocol, the bench's tester, trouble codes, and decoding of responses."""
