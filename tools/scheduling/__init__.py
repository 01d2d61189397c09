"""Simulation of how campaigns are scheduled on more workers than this machine has, fed by measurements here."""
