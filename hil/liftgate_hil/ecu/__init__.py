"""Electronic control units (ECUs) that close the loop: the reference ECU, and adapters for a user's own ECU.

The reference ECU (`reference`, `controller`, `anti_trap`, `speed_control`, `calibration`, `memory`) is a
readable controller that knows the gate only through its bus: it may use the codec and its own files, never the
plant.
"""
