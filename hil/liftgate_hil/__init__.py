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
    from liftgate_hil.campaigns.command import campaign
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.config.scenario import Scenario
    from liftgate_hil.conversion.compare import compare
    from liftgate_hil.conversion.convert import convert
    from liftgate_hil.conversion.plot import plot
    from liftgate_hil.drive.gate import Gate
    from liftgate_hil.drive.result import Result
    from liftgate_hil.drive.run import run
    from liftgate_hil.identification.commands import identify, validate
    from liftgate_hil.judging.verdict import Verdict
    from liftgate_hil.plan.setup import rig_from as load_rig
    from liftgate_hil.plan.setup import scenario_from as load_scenario
    from liftgate_hil.plan.setup import vehicle_from as load_vehicle
    from liftgate_hil.playback.replay import replay
    from liftgate_hil.simulation.simulate import simulate
    from liftgate_hil.testing.tested import judge, test
    from liftgate_plant.vehicle import Vehicle

    __version__: str

# Public name: (module, attribute). Imported on first use, so that commands start fast.
_HOMES = {
    "Gate": ("liftgate_hil.drive.gate", "Gate"),
    "Result": ("liftgate_hil.drive.result", "Result"),
    "Rig": ("liftgate_hil.config.rig", "Rig"),
    "Scenario": ("liftgate_hil.config.scenario", "Scenario"),
    "Vehicle": ("liftgate_plant.vehicle", "Vehicle"),
    "Verdict": ("liftgate_hil.judging.verdict", "Verdict"),
    "campaign": ("liftgate_hil.campaigns.command", "campaign"),
    "compare": ("liftgate_hil.conversion.compare", "compare"),
    "convert": ("liftgate_hil.conversion.convert", "convert"),
    "identify": ("liftgate_hil.identification.commands", "identify"),
    "judge": ("liftgate_hil.testing.tested", "judge"),
    "load_rig": ("liftgate_hil.plan.setup", "rig_from"),
    "load_scenario": ("liftgate_hil.plan.setup", "scenario_from"),
    "load_vehicle": ("liftgate_hil.plan.setup", "vehicle_from"),
    "plot": ("liftgate_hil.conversion.plot", "plot"),
    "replay": ("liftgate_hil.playback.replay", "replay"),
    "run": ("liftgate_hil.drive.run", "run"),
    "simulate": ("liftgate_hil.simulation.simulate", "simulate"),
    "test": ("liftgate_hil.testing.tested", "test"),
    "validate": ("liftgate_hil.identification.commands", "validate"),
}

__all__ = [
    "Gate",
    "Result",
    "Rig",
    "Scenario",
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
    if name in _HOMES:
        module, attribute = _HOMES[name]
        return getattr(import_module(module), attribute)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> "list[str]":
    """Return the public names of the package."""
    return [*__all__, "__version__"]
