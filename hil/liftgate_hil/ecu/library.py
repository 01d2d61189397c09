"""An ECU in C: a shared library with the functions of `liftgate_ecu.h`."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.ecu import wire
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import PORT
from liftgate_hil.errors import ConfigError, EcuError

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig


class LibraryEcu(Adapter):
    """A shared library with the functions of `liftgate_ecu.h`; called once a tick. Raises ConfigError."""

    kind = PORT

    def __init__(self, path: Path, rig: Rig, drives: int, shares_clock: bool = True) -> None:
        super().__init__(rig, drives, shares_clock)
        try:
            self._library = ctypes.CDLL(str(path.resolve()))
            names = ("create", "destroy", "step")
            create, self._destroy, step = (
                getattr(self._library, f"liftgate_ecu_{name}") for name in names
            )
        except (OSError, AttributeError) as error:
            raise ConfigError(
                f"`ecu` {path}: {error}; allowed: a shared library with the functions of liftgate_ecu.h"
            ) from error
        request = getattr(self._library, "liftgate_ecu_request", None)
        create.restype, create.argtypes = ctypes.c_void_p, []
        self._destroy.restype, self._destroy.argtypes = None, [ctypes.c_void_p]
        self._instance = create()
        if not self._instance:
            raise EcuError(f"`ecu` {path}: liftgate_ecu_create gave no ECU")
        port = wire.Port(wire.address_of(step), wire.address_of(request), self._instance, 0)
        self.node = self.node._replace(port=port)

    def close(self) -> None:
        """See Adapter."""
        instance, self._instance = self._instance, None
        if instance:
            self._destroy(instance)
