"""Other processes of a run: answers that foreign code cannot spoil, deadlines, and the end of all descendants."""
