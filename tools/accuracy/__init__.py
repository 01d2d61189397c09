"""How exact a step of 1 ms is, on vehicles and phases drawn at random."""
