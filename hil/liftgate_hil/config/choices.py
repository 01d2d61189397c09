"""Arguments that several commands share: vehicle, rig, scenario, bus or serial port, how recordings are read."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from liftgate_hil.config.described import Field, Record, value_of
from liftgate_hil.config.kinds import SEED, File, Flag, Loaded, NumberOr, NumbersByName, Text, Texts, Whole
from liftgate_hil.config.shipped import DEFAULT_RIG, DEFAULT_VEHICLE

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.config.scenario import Scenario, ScenarioFile
    from liftgate_hil.config.vehicle import VehicleFile
    from liftgate_plant.vehicle import Vehicle
else:  # not every command loads them; their kinds know their names
    Rig = Scenario = ScenarioFile = VehicleFile = Vehicle = object

# What stands for a scenario, a vehicle or a rig: a shipped name, a file, or the object.
AnyScenario = str | Path | ScenarioFile | Scenario
AnyVehicle = str | Path | VehicleFile | Vehicle
AnyRig = str | Path | Rig
SCENARIO = Loaded(("Scenario", "ScenarioFile"))
VEHICLE = Loaded(("Vehicle", "VehicleFile"))
RIG = Loaded(("Rig",))


# fmt: off
class VehicleSettings(Record):
    """Base class of the requests (arguments of a command) that override values of a vehicle file."""

    settings: Annotated[Sequence[str], Field(Texts("a list of KEY=VALUE"), "replace a value of the vehicle "
        "file, e.g. environment.road_slope_deg=8 (repeatable)", metavar="KEY=VALUE", flag="set")] = ()
    draw: Annotated[int | None, Field(SEED, "draw one car from the vehicle file's [spread]",
        "the file's own values", "SEED")] = None
    ideal: Annotated[bool, Field(Flag(), "the thesis's plant: no noise, ripple, sensor errors, torsion, source "
        "resistance or wear")] = False


class VehicleChoice(VehicleSettings):
    """Base class of the requests (arguments of a command) that select a vehicle."""

    vehicle: Annotated[str | Path, Field(File(), "the vehicle: a shipped name, or a "
        "file", metavar="NAME|FILE")] = DEFAULT_VEHICLE


OwnVehicle = Annotated[AnyVehicle | None, Field(VEHICLE, "the vehicle: a shipped name, or "
    "a file", f"the scenario's, else {DEFAULT_VEHICLE}", "NAME|FILE")]
OwnRig = Annotated[AnyRig | None, Field(RIG, "the rig: mapping of bus signals",
    f"the scenario's, else {DEFAULT_RIG}", "NAME|FILE")]
OwnSeed = Annotated[int | None, Field(SEED, "seed of noise and other random values", "the scenario's, else "
    "0", "SEED")]
# Of recordings that are read.
RecordingChannel = Annotated[str | None, Field(Text("the name of a bus"),
    "bus to read if the file contains several: can0", metavar="NAME")]
TimeZone = Annotated[str | None, Field(Text("a zone such as UTC or Europe/Berlin"),
    "zone of local times in files: UTC, Asia/Shanghai", "the computer's", "ZONE")]
Parameters = Annotated[Mapping[str, float] | Sequence[str] | None, Field(NumbersByName(), "replace a parameter of "
    "the scenario (repeatable)", metavar="NAME=VALUE", flag="set-parameter")]


class ParametersChoice(Record):
    """Base class of the requests (arguments of a command) that set parameters of a scenario."""

    parameters: Parameters = ()

    @property
    def parameter_values(self) -> dict[str, float]:
        """The scenario's parameter values of the request, by name. Raises ConfigError."""
        found: dict[str, float] = value_of("parameters", self.parameters or (), NumbersByName())
        return found


class SetupChoice(ParametersChoice, VehicleSettings):
    """Base class of the requests (arguments of a command) that select a vehicle and a scenario."""

    scenario: Annotated[AnyScenario | None, Field(SCENARIO, "what happens over time", metavar="NAME|FILE")] = None
    vehicle: OwnVehicle = None
    initial: Annotated[float | str | None, Field(NumberOr("closed, open, or degrees"), "where the gate starts",
        "the scenario's, else closed", "closed|open|ANGLE_deg")] = None
    seed: OwnSeed = None


# fmt: off
class WireChoice(Record):
    """The user's choice of a connection: a bus by one text or by python-can's own options, or a serial port."""

    bus: Annotated[str | None, Field(Text("INTERFACE:CHANNEL[@BITRATE]"), "the CAN bus, e.g. socketcan:vcan0",
        metavar="INTERFACE:CHANNEL[@BITRATE]")] = None
    serial: Annotated[str | None, Field(Text("PORT[@BAUD]"), "instead of a bus: a device or URL of pyserial, e.g. "
        "/dev/ttyUSB0@921600", metavar="PORT[@BAUD]")] = None
    interface: Annotated[str | None, Field(Text(), "python-can's interface, instead of "
        "--bus", also=("-i",))] = None
    channel: Annotated[str | None, Field(Text(), "python-can's channel, instead of --bus", also=("-c",))] = None
    bitrate: Annotated[int | None, Field(Whole(1, 100_000_000), "bit/s", "the rig's", also=("-b",))] = None
    is_fd: Annotated[bool, Field(Flag(), "open the bus for CAN FD", flag="fd")] = False

    # fmt: on
    @property
    def is_given(self) -> bool:
        """Whether the user chose a bus or a serial port at all."""
        named = (self.bus, self.serial, self.interface, self.channel)
        return any(each is not None for each in named)

    @property
    def is_configured(self) -> bool:
        """Whether python-can's configuration names a bus: can.conf, or CAN_* in the environment."""
        from liftgate_hil.config.can_libraries import can

        try:
            return can.util.load_config().get("interface") is not None
        except Exception:  # what is wrong with it is told where it is used
            return any(name.startswith("CAN_") for name in os.environ)
