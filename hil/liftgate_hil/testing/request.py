"""Requests of `judge` and of `test`, and the flags of `demo`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from liftgate_hil.config.choices import (
    RIG,
    SCENARIO,
    AnyRig,
    AnyScenario,
    OwnRig,
    OwnSeed,
    OwnVehicle,
    ParametersChoice,
    RecordingChannel,
    TimeZone,
    VehicleSettings,
    WireChoice,
)
from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Choice, File, Flag, Number, Paths, Raw, Text, Whole
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.suffixes import WITH_FRAMES, WITH_ROWS
from liftgate_hil.measurement.request import MapRequest
from liftgate_hil.plan.request import DEFAULT_RATE, AskForRealtime, Clock, Cpu, Rate, WallTimeout, check_cpu


# fmt: off
class JudgedFiles(Record, kw_only=False):
    """Base class of JudgeRequest: the recordings, and the scenario and rig to judge them by."""

    recordings: Annotated[str | Path | Sequence[str | Path], Field(Paths(), "recordings of one run, or of "
        f"several: tables {' '.join(WITH_ROWS)}, bus logs {' '.join(WITH_FRAMES)}", metavar="RECORDING")]
    scenario: Annotated[AnyScenario, Field(SCENARIO, "the scenario with the expectations",
        metavar="NAME|FILE", flag="scenario")]


class ReportsChoice(Record):
    """Base class of the requests that report verdicts: the report files."""

    json: Annotated[str | Path | None, Field(File(), "write the verdicts as JSON; -: to stdout",
        metavar="FILE")] = None
    junit: Annotated[str | Path | None, Field(File(), "write the verdicts as JUnit XML", metavar="FILE")] = None
    html: Annotated[str | Path | None, Field(File(), "write a report with pictures: one file for any browser",
        metavar="FILE")] = None
    results: Annotated[str | Path | None, Field(File(), "write all three into this folder, beside the recordings "
        "of `test`", metavar="FOLDER")] = None


class JudgeRequest(JudgedFiles, ReportsChoice, ParametersChoice, MapRequest):
    """Request to judge recordings by a scenario's expectations."""

    vehicle: OwnVehicle = None
    rig: Annotated[AnyRig | None, Field(RIG, "a rig, or a database: decodes the frames", "the "
        "scenario's, else liftgate", "NAME|FILE")] = None
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None
    duration: Annotated[float | None, Field(Number(1e-3, 1e9, "s"), "end of the run", "the scenario's, else the "
        "recording's", "S")] = None
    rate: Annotated[float, Field(Number(1.0, 10_000.0, "Hz"), "ticks per second in which recordings of other "
        "tools are judged", metavar="HZ")] = DEFAULT_RATE
    longest_gap: Annotated[float | None, Field(Number(1e-6, 1e9, "s"), "longest gap between two samples of a "
        "column in recordings of other tools; a longer one makes windows inconclusive", "three times the column's "
        "usual interval", "S")] = None
    origin: Annotated[float | None, Field(Number(-1e10, 1e10, "s"), "where the run begins in recordings of other "
        "tools, by their times", "with their first sample", "S")] = None
    one_run: Annotated[bool, Field(Flag(), "all files belong to one run, whatever their names")] = False


class SuiteFiles(Record, kw_only=False):
    """Base class of SuiteRequest: the scenarios to run, and the ECU to test."""

    paths: Annotated[str | Path | Sequence[str | Path], Field(Paths(), "scenario files, or folders of them; "
        "shipped: pack, pack/crank_dip", metavar="PATH")]
    ecu: Annotated[str | Path, Field(Raw("reference, the path of a shared library, MODULE:CLASS, mutant:NAME, "
        "bus"), "what closes the loop: the reference ECU, a C library, a Python class, a mutant of the reference "
        "ECU, an ECU on the bus", metavar="reference|LIBRARY|MODULE:CLASS|mutant:NAME|bus")] = REFERENCE


class SuiteRequest(SuiteFiles, ReportsChoice, ParametersChoice, VehicleSettings, WireChoice):
    """Request to run scenarios as tests."""

    clock: Clock = "free"
    rate: Rate = DEFAULT_RATE
    wall_timeout: WallTimeout = None
    realtime: AskForRealtime = None
    cpu: Cpu = None
    rig: OwnRig = None
    vehicle: OwnVehicle = None
    seed: OwnSeed = None
    jobs: Annotated[int | None, Field(Whole(1, 1024), "run N scenarios at a time", "one per CPU", "N")] = None
    retry_inconclusive: Annotated[int, Field(Whole(0, 100), "run a scenario that is inconclusive again, up to "
        "N times: every attempt is reported, and a fail in any of them counts", metavar="N")] = 0
    recordings: Annotated[str | None, Field(Choice(("all", "failed", "none")), "scenarios whose recordings stay "
        "in the folder of --results; failed: those that do not pass", "all, some 50 MB a minute of each",
        needs="results")] = None
    mutants: Annotated[bool, Field(Flag(), "also run all scenarios with mutants of the reference ECU; report "
        "which scenario finds which defect, and which expectations prove nothing")] = False
    mutation_threshold: Annotated[float | None, Field(Number(0.0, 100.0, "%"), "with --mutants: fail, with exit "
        "code 1, if fewer of the mutants are killed", "report only", "PERCENT", "mutants")] = None

    # fmt: on
    def check(self) -> None:
        """Validate the values, each and together. Raises ConfigError."""
        super().check()
        if self.is_given and self.ecu != ON_A_BUS:
            raise ConfigError("`bus`: allowed together with `ecu` bus; other ECUs run without a bus")
        if self.mutants and (self.ecu != REFERENCE or self.clock != "free"):
            raise ConfigError("`mutants`: allowed with `ecu` reference and `clock` free")
        check_cpu(self.cpu)


# fmt: off
class DemoFiles(Record):
    """Flags that only `demo` has: the files that it writes, and the serial line of its ECU."""

    ecu_serial: Annotated[str | None, Field(Text("PORT[@BAUD]"), "the other end of --serial, for the ECU",
        metavar="PORT[@BAUD]")] = None
    output: Annotated[str | Path, Field(File(), "folder for demo.log, demo.csv and demo.png, created if missing",
        metavar="FOLDER")] = "."
    no_record: Annotated[bool, Field(Flag(), "write no demo.log, demo.csv and demo.png")] = False
