"""Executors of batches of variants: this process, processes on this machine, a Dask cluster."""
