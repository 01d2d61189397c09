"""Faults, requests and signals that a test bench's messages inject while a run goes on."""
