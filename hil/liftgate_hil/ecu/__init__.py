"""Electronic control units that close the loop: the reference ECU, and what connects a user's own.

The reference ECU (`reference`, `controller`, `anti_trap`, `load`, `speed_control`, `calibration`, `memory`) is an
honest, readable controller that knows the gate only through its bus: it may use the codec and its own files, never
the plant.
"""
