"""How other processes attach to a run: they see its loop's memory, and have commands obeyed."""
