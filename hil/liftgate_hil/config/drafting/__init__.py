"""A first rig for a foreign database, by the names, units, ranges, labels and senders of its signals."""
