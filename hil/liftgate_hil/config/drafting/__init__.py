"""Draft a rig file for an unknown database from names, units, ranges, labels and senders of its signals."""
