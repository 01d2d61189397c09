"""Stands in for asammdf, which cantools imports if available and no command of the manual needs."""

raise ImportError("not loaded: `c_ecu.BARE_CANTOOLS` says why")
