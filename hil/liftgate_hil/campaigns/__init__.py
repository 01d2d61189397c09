"""Campaigns: many variants of a scenario, as grids, samples, a worst-case search or a probability estimate."""
