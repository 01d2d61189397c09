"""Diagnostics on the bus: transport protocol, the bench's tester, trouble codes, and what answers say of them."""
