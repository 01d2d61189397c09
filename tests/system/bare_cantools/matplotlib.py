"""Stands for matplotlib, which cantools loads where it can, and needs for no command of the pages."""

raise ImportError("not loaded: `c_ecu.BARE_CANTOOLS` says why")
