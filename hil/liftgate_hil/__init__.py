"""Hardware-in-the-loop emulator of a power lift gate.

    import liftgate_hil as lh
    with lh.Gate(vehicle="suv", rig="liftgate") as gate:            # step it yourself
        gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
        frames = gate.step(0.010)
    result = lh.run("demo", ecu="reference", clock="free")          # or run a scenario against an ECU

The names in `__all__` are public; all others may change. Errors are those of `liftgate_hil.errors`.
"""

from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, without its import
if TYPE_CHECKING:
    from liftgate_hil import errors
    from liftgate_hil.campaigns.command import CampaignResult, campaign
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.config.scenario import Scenario
    from liftgate_hil.conversion.compare import Comparison, compare
    from liftgate_hil.conversion.convert import Converted, convert
    from liftgate_hil.conversion.plot import Plotted, plot
    from liftgate_hil.drive.gate import Gate
    from liftgate_hil.drive.result import Result
    from liftgate_hil.drive.run import run
    from liftgate_hil.identification.commands import identify, validate
    from liftgate_hil.identification.result import Identification, Validation
    from liftgate_hil.judging.verdict import Verdict
    from liftgate_hil.plan.setup import rig_from as load_rig
    from liftgate_hil.plan.setup import scenario_from as load_scenario
    from liftgate_hil.plan.setup import vehicle_from as load_vehicle
    from liftgate_hil.playback.player import Played
    from liftgate_hil.playback.replay import replay
    from liftgate_hil.simulation.simulate import Simulation, simulate
    from liftgate_hil.testing.tested import SuiteResult, judge, test
    from liftgate_plant.vehicle import Vehicle

    __version__: str

# Modules of the public names, imported on first use, so that commands start fast.
_HOMES = {
    "liftgate_hil.campaigns.command": ("CampaignResult", "campaign"),
    "liftgate_hil.config.rig": ("Rig",),
    "liftgate_hil.config.scenario": ("Scenario",),
    "liftgate_hil.conversion.compare": ("Comparison", "compare"),
    "liftgate_hil.conversion.convert": ("Converted", "convert"),
    "liftgate_hil.conversion.plot": ("Plotted", "plot"),
    "liftgate_hil.drive.gate": ("Gate",),
    "liftgate_hil.drive.result": ("Result",),
    "liftgate_hil.drive.run": ("run",),
    "liftgate_hil.identification.commands": ("identify", "validate"),
    "liftgate_hil.identification.result": ("Identification", "Validation"),
    "liftgate_hil.judging.verdict": ("Verdict",),
    "liftgate_hil.playback.player": ("Played",),
    "liftgate_hil.playback.replay": ("replay",),
    "liftgate_hil.plan.setup": ("load_rig", "load_scenario", "load_vehicle"),
    "liftgate_hil.simulation.simulate": ("Simulation", "simulate"),
    "liftgate_hil.testing.tested": ("SuiteResult", "judge", "test"),
    "liftgate_plant.vehicle": ("Vehicle",),
}
_OTHERS = {"load_rig": "rig_from", "load_scenario": "scenario_from", "load_vehicle": "vehicle_from"}

__all__ = [
    "CampaignResult",
    "Comparison",
    "Converted",
    "Gate",
    "Identification",
    "Played",
    "Plotted",
    "Result",
    "Rig",
    "Scenario",
    "Simulation",
    "SuiteResult",
    "Validation",
    "Vehicle",
    "Verdict",
    "campaign",
    "compare",
    "convert",
    "errors",
    "identify",
    "judge",
    "load_rig",
    "load_scenario",
    "load_vehicle",
    "plot",
    "replay",
    "run",
    "simulate",
    "test",
    "validate",
]


def __getattr__(name: str) -> object:
    """Return a public name of the package, imported from its module on first use."""
    if name == "__version__":
        from liftgate_hil.version import version

        return version()
    if name == "errors":
        return import_module("liftgate_hil.errors")
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), _OTHERS.get(name, name))
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> "list[str]":
    """Return the public names of the package."""
    return [*__all__, "__version__"]
