"""Import python-can and cantools without asammdf.

python-can imports asammdf, and with it pandas, if they are installed. That takes 0.6 s and serves its MF4 writer
only. `formats.mf4_file` writes MF4 files without python-can, so asammdf is hidden during the import.
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
