"""Probability of a rare failure: subset simulation and importance sampling."""
