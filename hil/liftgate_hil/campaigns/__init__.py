"""Campaigns: many variants of a scenario, in grids and samples, in a search for the worst, as a probability."""
