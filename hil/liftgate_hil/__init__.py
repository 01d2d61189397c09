"""Hardware-in-the-loop emulator of a power lift gate.

    import liftgate_hil as lh
    with lh.Gate(vehicle="suv", rig="liftgate") as gate:            # step it yourself
        gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
        frames = gate.step(0.010)
    result = lh.run("demo", ecu="reference", clock="free")          # or run a scenario against an ECU

What is named here is public; all else may change. Errors are those of `liftgate_hil.errors`.
"""

from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, which nobody needs here
if TYPE_CHECKING:
    from liftgate_hil import errors
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.config.scenario import Scenario
    from liftgate_hil.gate import Gate
    from liftgate_hil.judging.verdict import Verdict
    from liftgate_hil.runs.result import Result
    from liftgate_hil.runs.run import run
    from liftgate_hil.session import rig_from as load_rig
    from liftgate_hil.session import scenario_from as load_scenario
    from liftgate_hil.session import vehicle_from as load_vehicle
    from liftgate_hil.testing.rejudge import judge
    from liftgate_plant.vehicle import Vehicle

    __version__: str

# Public name: where it is. Imported when it is asked for, so that starting a command stays fast.
_HOMES = {
    "Gate": ("liftgate_hil.gate", "Gate"),
    "Result": ("liftgate_hil.runs.result", "Result"),
    "Rig": ("liftgate_hil.config.rig", "Rig"),
    "Scenario": ("liftgate_hil.config.scenario", "Scenario"),
    "Vehicle": ("liftgate_plant.vehicle", "Vehicle"),
    "Verdict": ("liftgate_hil.judging.verdict", "Verdict"),
    "judge": ("liftgate_hil.testing.rejudge", "judge"),
    "load_rig": ("liftgate_hil.session", "rig_from"),
    "load_scenario": ("liftgate_hil.session", "scenario_from"),
    "load_vehicle": ("liftgate_hil.session", "vehicle_from"),
    "run": ("liftgate_hil.runs.run", "run"),
}

__all__ = [
    "Gate",
    "Result",
    "Rig",
    "Scenario",
    "Vehicle",
    "Verdict",
    "errors",
    "judge",
    "load_rig",
    "load_scenario",
    "load_vehicle",
    "run",
]


def __getattr__(name: str) -> object:
    """A public name, from where it is."""
    if name == "__version__":
        from liftgate_hil.version import version

        return version()
    if name == "errors":
        return import_module("liftgate_hil.errors")
    if name in _HOMES:
        module, attribute = _HOMES[name]
        return getattr(import_module(module), attribute)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names."""
    return [*__all__, "__version__"]
