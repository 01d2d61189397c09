"""python-can and cantools, loaded without asammdf.

python-can imports asammdf, and with it pandas, wherever that is installed: 0.6 s that only its MF4 writer
needs. MF4 files are written by `recording.mf4_file`, without python-can, so here it is kept out.
"""

import sys

_hidden = "asammdf" not in sys.modules and "can" not in sys.modules
if _hidden:
    sys.modules["asammdf"] = None  # type: ignore[assignment]  # makes the import fail
try:
    import can
    import cantools
finally:
    if _hidden:
        del sys.modules["asammdf"]

__all__ = ["can", "cantools"]
