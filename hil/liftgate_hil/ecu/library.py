"""Adapter of an ECU in C: a shared library with the functions of `liftgate_ecu.h`."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.ecu import wire
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import PORT
from liftgate_hil.errors import ConfigError, EcuError

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig


class LibraryEcu(Adapter):
    """Adapter of a shared library with the functions of `liftgate_ecu.h`, called once a tick.

    Raises ConfigError, EcuError.
    """

    kind = PORT
    request_name = "liftgate_ecu_request"

    def __init__(self, path: Path, rig: Rig, drives: int, shares_clock: bool = True) -> None:
        super().__init__(rig, drives, shares_clock)
        self._path = path.resolve()
        self._load(path)

    def _load(self, path: Path) -> None:
        """Load the library, and create its ECU. Raises ConfigError, EcuError."""
        try:
            self._library = ctypes.CDLL(str(self._path))
            names = ("create", "destroy", "step")
            create, self._destroy, step = (getattr(self._library, f"liftgate_ecu_{name}") for name in names)
        except (OSError, AttributeError) as error:
            raise ConfigError(
                f"`ecu` {path}: {error}; allowed: a shared library with the functions of liftgate_ecu.h"
            ) from error
        request = getattr(self._library, self.request_name, None)
        create.restype, create.argtypes = ctypes.c_void_p, []
        self._destroy.restype, self._destroy.argtypes = None, [ctypes.c_void_p]
        self._instance = create()
        if not self._instance:
            raise EcuError(f"`ecu` {path}: liftgate_ecu_create gave no ECU")
        port = wire.Port(wire.address_of(step), wire.address_of(request), self._instance, 0)
        self.node = self.node._replace(port=port)

    def reset(self) -> None:
        """Reset the ECU by loading the library again, so that its statics have their initial values.

        Raises ConfigError, EcuError.
        """
        self.close()
        handle = self._library._handle
        del self._library, self._destroy
        unload = ctypes.CDLL(None).dlclose
        unload.restype, unload.argtypes = ctypes.c_int, [ctypes.c_void_p]
        unload(handle)
        try:
            ctypes.CDLL(str(self._path), mode=os.RTLD_NOLOAD | os.RTLD_NOW)
        except OSError:  # unloaded, as it shall be
            super().reset()
            self._load(self._path)
            return
        raise EcuError(f"`ecu` {self._path}: cannot be reloaded; allowed: a library that can be unloaded")

    def close(self) -> None:
        """Destroy the library's ECU."""
        instance, self._instance = self._instance, None
        if instance:
            self._destroy(instance)
