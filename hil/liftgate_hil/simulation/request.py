"""Request of `simulate`."""

from pathlib import Path
from typing import Annotated

from liftgate_hil.config.choices import SetupChoice
from liftgate_hil.config.described import Field
from liftgate_hil.config.kinds import File, Number, Whole
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.suffixes import WITH_ROWS, either
from liftgate_hil.measurement.request import MapRequest


# fmt: off
class SimulateRequest(SetupChoice, MapRequest):
    """Request to simulate the plant alone."""

    voltage: Annotated[float | None, Field(Number(-1000.0, 1000.0, "V"), "step of the motor voltage on both "
        "drives",
        metavar="V")] = None
    input: Annotated[str | Path | None, Field(File(), f"{either(WITH_ROWS)} with time_s and input columns; its "
        "first sample becomes time 0", metavar="FILE")] = None
    duration: Annotated[float | None, Field(Number(0.0, 1e7, "s"), "model time", "the scenario's, else to the "
        "input's last sample, an hour at most", "S")] = None
    step: Annotated[float, Field(Number(1e-5, 5e-3, "s"), "step of the simulation, 1e-5 to "
        "5e-3", metavar="S")] = 0.001
    every: Annotated[int, Field(Whole(1, 10**9), "write every N-th step", metavar="N")] = 1
    output: Annotated[str | Path | None, Field(File(), ".csv, .parquet, .mf4 or .mcap", "CSV to "
        "stdout", "FILE")] = None
    edges: Annotated[str | Path | None, Field(File(), "also write every edge of the Hall sensors to a .csv: "
        "time_s, drive, channel, level", metavar="FILE")] = None

    # fmt: on
    def check(self) -> None:
        """Validate the values, each and together. Raises ConfigError."""
        super().check()
        if self.voltage is not None and self.input is not None:
            raise ConfigError("`voltage`: not allowed with `input`")
        if self.maps and self.input is None:
            raise ConfigError("`maps`: allowed with `input`")
