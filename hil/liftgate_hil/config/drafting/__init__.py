"""Draft a rig for an unknown database by the names, units, ranges, labels and senders of its signals."""
