"""The plant alone: inputs from a file or a step, rows of outputs."""
