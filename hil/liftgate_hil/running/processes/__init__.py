"""Child processes: answers that foreign code cannot spoil, deadlines, and the end of all their descendants."""
