"""Request of a campaign, in plain values; campaign.json stores those that determine its results."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

from liftgate_hil.config.choices import OwnSeed, ParametersChoice, VehicleSettings
from liftgate_hil.config.described import Field, Record, fields_of, value_of
from liftgate_hil.config.kinds import SEED, Choice, Flag, Kind, Raw, Text, Texts, Whole
from liftgate_hil.config.shipped import DEFAULT_RIG, DEFAULT_VEHICLE
from liftgate_hil.config.toml import show
from liftgate_hil.ecu.names import REFERENCE
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.request import DEFAULT_RATE, Duration, Rate

DESIGN, WORST, PROBABILITY = "design", "worst", "probability"  # kinds of campaigns
METHODS = ("sobol", "lhs", "random")  # of sampling
DEFAULT_METHOD = METHODS[0]


# fmt: off
class CampaignSubject(Record, kw_only=False):
    """Base class of the campaign request: its positional arguments, the scenario and what is varied."""

    scenario: Annotated[str | Path, Field(Text("a scenario or campaign file, or a shipped name"), "a scenario or "
        "campaign file, or a shipped name (pack:trap-matrix); with --replay the folder of a campaign",
        metavar="SCENARIO|FOLDER")]
    vary: Annotated[Sequence[str], Field(Texts("a list of texts"), "vary a parameter of the scenario, seed, draw, "
        "or a key of the vehicle file: rod=10000,20000, angle=10:70:13, 'rod~loguniform(5e3,1e5)'; vehicle: draws "
        "from the covariance of its [identification] (repeatable; all combinations)",
        metavar="NAME=VALUES|NAME~DISTRIBUTION|vehicle")] = ()


class CampaignRequest(CampaignSubject, ParametersChoice, VehicleSettings):
    """Request to run a campaign; campaign.json stores the values that determine its results."""

    samples: Annotated[int | None, Field(Whole(1, 10**9), "samples of the distributions", metavar="N")] = None
    method: Annotated[str | None, Field(Choice(METHODS), "how samples are drawn", "sobol")] = None
    sampling_seed: Annotated[int, Field(SEED, "seed of samples and searches", metavar="SEED")] = 0
    worst: Annotated[str | None, Field(Text(), "search for the smallest margin of this expectation",
        metavar="NAME")] = None
    evaluations: Annotated[int | None, Field(Whole(10, 10**7), "evaluations at most", "500 for --worst, which "
        "draws as many at random to compare with, and 5000 for --probability, at least 1200", "N")] = None
    probability: Annotated[str | None, Field(Text(), "estimate the probability that this expectation fails",
        metavar="NAME")] = None
    ecu: Annotated[str | Path, Field(Text("reference, mutant:NAME, a library, MODULE:CLASS"), "what closes the "
        "loop: the reference ECU, a C library, a Python class, a mutant of the reference ECU",
        metavar="reference|LIBRARY|MODULE:CLASS|mutant:NAME")] = REFERENCE
    against: Annotated[str | Path | None, Field(Text(), "another ECU, or a mutant of the reference ECU, for the "
        "same variants", metavar="ECU")] = None
    vehicle: Annotated[str | Path | None, Field(Text("a shipped name, or a file"), "the vehicle: a shipped name, "
        "or a file", f"the scenario's, else {DEFAULT_VEHICLE}", "NAME|FILE")] = None
    rig: Annotated[str | Path | None, Field(Text("a shipped name, or a file"), "the rig",
        f"the scenario's, else {DEFAULT_RIG}", "NAME|FILE")] = None
    seed: OwnSeed = None
    rate: Rate = DEFAULT_RATE
    duration: Duration = None
    jobs: Annotated[int | None, Field(Whole(1, 1024), "processes on this machine", "one per CPU", "N")] = None
    scheduler: Annotated[str | None, Field(Text(), "a Dask scheduler whose workers evaluate",
        metavar="tcp://HOST:PORT")] = None
    store: Annotated[str | Path | None, Field(Text(), "where batches are kept, a folder or an address of fsspec",
        "in --output", "FOLDER")] = None
    output: Annotated[str | Path, Field(Text(), "results.parquet, campaign.json, report.html",
        metavar="FOLDER")] = "campaign"
    resume: Annotated[bool, Field(Flag(), "go on with the campaign in --output")] = False

    # fmt: on
    @property
    def kind(self) -> str:
        """Kind of the campaign: DESIGN, WORST or PROBABILITY."""
        return WORST if self.worst else PROBABILITY if self.probability else DESIGN

    @property
    def expectation(self) -> str:
        """Name of the expectation of a WORST or PROBABILITY campaign; "": none."""
        return self.worst or self.probability or ""

    def check(self) -> None:
        """Validate the values, each and together. Raises ConfigError."""
        super().check()
        issues = ["`worst`: allowed without `probability`"] if self.worst and self.probability else []
        if self.kind == DESIGN and self.evaluations:
            issues.append(f"`evaluations` {self.evaluations}: allowed with `worst` or `probability`")
        if self.kind != DESIGN and self.samples:
            issues.append(f"`samples` {self.samples}: allowed without `{self.kind}`")
        if issues:
            raise ConfigError(issues)

    def kept(self) -> dict[str, Any]:
        """Return the values that determine the results, for JSON; None becomes the `_NOT_GIVEN` value, if any."""
        values = {**self.to_dict(), "parameters": self.parameter_values, "kind": self.kind}
        values["expectation"] = self.expectation
        found = {name: _NOT_GIVEN.get(name) if values[name] is None else values[name] for name in _KEPT}
        return {name: list(each) if isinstance(each, tuple) else each for name, each in found.items()}

    @classmethod
    def of_kept(cls, given: Any) -> Self:
        """Restore a request from the values of `kept`. Raises ConfigError where they are damaged."""
        if not isinstance(given, Mapping) or set(given) != set(_KEPT):
            raise ConfigError(
                "campaign.json: request: damaged or of another version; allowed: as this version writes it"
            )
        known = {each.name: each for each in fields_of(cls)}
        kinds: dict[str, Kind] = {"kind": Choice((DESIGN, WORST, PROBABILITY)), "expectation": Raw("a text")}
        values: dict[str, Any] = {}
        wrong: list[str] = []
        for name, value in given.items():
            if name in _NOT_GIVEN and type(value) is type(_NOT_GIVEN[name]) and value == _NOT_GIVEN[name]:
                continue
            try:
                is_null = value is None and name in known and known[name].may_be_none
                kind = kinds[name] if name in kinds else known[name].kind
                values[name] = None if is_null else value_of(name, value, kind)
            except ConfigError:
                wrong.append(name)
        numbers = given["parameters"].values() if isinstance(given["parameters"], Mapping) else ()
        wrong += ["parameters"] if any(type(each) not in (int, float) for each in numbers) else []
        wrong += [] if isinstance(given["expectation"], str) else ["expectation"]
        if wrong:
            names = [name for name in given if name in wrong]
            text = "allowed: as it was written"
            raise ConfigError([f"campaign.json: request.{name}: {show(given[name])}; {text}" for name in names])
        chosen, expectation = values.pop("kind"), values.pop("expectation", "")
        own = {chosen: expectation} if chosen != DESIGN else {}
        defaults = cls("").kept()
        return cls(**{name: each for name, each in values.items() if given[name] != defaults[name]}, **own)


# What campaign.json has of a request, and what stands there for None.
_KEPT = (
    *("scenario", "vary", "ecu", "against", "vehicle", "rig", "settings", "parameters", "seed", "draw", "ideal"),
    *("rate", "duration", "kind", "expectation", "samples", "method", "sampling_seed", "evaluations"),
)
_NOT_GIVEN = {"against": "", "samples": 0, "method": "", "evaluations": 0}
