"""Child processes: answers that foreign code cannot spoil, deadlines, an end for all that a child has started."""
