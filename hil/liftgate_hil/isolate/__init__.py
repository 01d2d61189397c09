"""Other processes of a run: answers protected from foreign code, deadlines, and the end of all descendants."""
