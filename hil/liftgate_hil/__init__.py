"""Everything around the plant: bus, loop, scenarios, recordings, the reference ECU and the commands."""
