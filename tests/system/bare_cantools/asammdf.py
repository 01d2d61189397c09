"""Stands for asammdf, which cantools loads where it can, and needs for no command of the pages."""

raise ImportError("not loaded: `readme.start` says why")
