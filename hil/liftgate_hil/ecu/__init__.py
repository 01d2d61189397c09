"""The reference ECU: an honest, readable controller that knows the gate only through its bus.

It may use the codec and its own files; it never imports the plant.
"""
