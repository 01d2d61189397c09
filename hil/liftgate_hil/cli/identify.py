"""Parameters of a vehicle from measurements: a nonlinear grey box by prediction-error minimisation.

A FILE has time_s, the inputs (motor voltages or duties) and what was measured of currents, speeds, positions or
Hall counts and the gate's angle: CSV, MF4, or a bus log with its rig. With --plan: which experiment would tell
most.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from liftgate_hil.cli import fitting, options
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.identify.descent import Report
    from liftgate_hil.identify.design import Plan
    from liftgate_hil.identify.problem import Sought
    from liftgate_hil.identify.result import Identification
    from liftgate_hil.report.provenance import Provenance
    from liftgate_plant.vehicle import Vehicle


_LEAST_STD = 1e-100  # of a prior: its weight is the square of the inverse


class Preset(NamedTuple):
    """A predefined choice of free parameters, model and outputs."""

    estimate: str
    model: str
    outputs: str


_THESIS = "current,speed,position"
PRESETS = {
    # §4.6.1, Table 4.1
    "thesis-1": Preset(
        "motor.resistance,motor.inductance,motor.rotor_inertia,motor.load_torque", "third-order", _THESIS
    ),
    # §4.6.2, Table 4.2
    "thesis-2": Preset(
        "motor.resistance,motor.inductance,motor.torque_constant,motor.speed_constant,motor.efficiency",
        "third-order",
        _THESIS,
    ),
    # §4.6.3: the first run without the inductance
    "thesis-3": Preset("motor.resistance,motor.rotor_inertia,motor.load_torque", "second-order", _THESIS),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    from liftgate_hil.cli.measurements import add_measurement_arguments

    add_measurement_arguments(parser, required=False)
    fitting.add_model(parser)
    parser.add_argument(
        "--estimate",
        metavar="LIST",
        help="parameters to estimate: keys of the vehicle file, e.g. motor.resistance,gear.backlash",
    )
    parser.add_argument(
        "--preset", choices=tuple(PRESETS), help="parameters, model and outputs of the thesis (4.6.1 to 4.6.3)"
    )
    parser.add_argument(
        "--bounds",
        action="append",
        default=[],
        metavar="KEY=LOW:HIGH",
        help="search a parameter only in this range (repeatable)",
    )
    parser.add_argument(
        "--prior",
        action="append",
        default=[],
        metavar="KEY=MEAN:STD",
        help="prior mean and standard deviation of a parameter (repeatable)",
    )
    parser.add_argument(
        "--noise",
        action="append",
        default=[],
        metavar="OUTPUT=STD",
        help="standard deviation of the noise of current, speed, position or angle, in the column's unit; "
        "default: estimated (repeatable)",
    )
    parser.add_argument("--profile", metavar="LIST", help="show the profile likelihood of these keys")
    parser.add_argument("--result", metavar="FILE.json", help="write the result")
    parser.add_argument("--save-vehicle", metavar="FILE.toml", help="write the vehicle file with the estimates")
    parser.add_argument("--html", metavar="FILE", help="write a report with plots")
    parser.add_argument(
        "--plan",
        action="store_true",
        help="rank experiments by the information that they would give; takes no FILE",
    )
    parser.add_argument(
        "--duration",
        type=options.bounded(0.1, 60.0, "s"),
        default=4.0,
        metavar="S",
        help="duration of a planned experiment; default: 4",
    )
    parser.add_argument(
        "--save-inputs",
        metavar="FOLDER",
        help="with --plan: write the motor voltages of the best sequence, a CSV for each experiment, for "
        "--input of `simulate`",
    )


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.running.compilation import reporting_compilation

    teller = Teller(args.quiet)
    with reporting_compilation(teller):
        return _run(args, teller)


def _run(args: argparse.Namespace, teller: Teller) -> int:
    from liftgate_hil.report.files import check_targets
    from liftgate_hil.report.numbers import significant

    targets = {"--result": args.result, "--save-vehicle": args.save_vehicle, "--html": args.html}
    check_targets(targets, fitting.inputs_of(args))
    origin = fitting.origin_of(args)
    if args.plan:
        return _plan(args, teller, origin)
    if args.save_inputs is not None:
        raise ConfigError("`save_inputs`: allowed with --plan")
    with teller.progress("identify") as progress:

        def tell(iteration: int, loss: float, step: float) -> None:
            numbers = f"loss {significant(loss, 6)}  step {significant(step, 3)}"
            progress.update(text=f"iteration {iteration}  {numbers}")

        result = identified(args, tell)
    _deliver(args, teller, origin, result)
    return 0


def _wanted(args: argparse.Namespace) -> tuple[Vehicle, str, list[Sought], str | None]:
    """Return vehicle, model, free parameters and outputs of the flags, or of the preset. Raises ConfigError."""
    preset = PRESETS[args.preset] if args.preset else Preset("", "full", "")
    vehicle = options.vehicle_of(args)
    sought = _sought(args, vehicle, args.estimate or preset.estimate)
    return (
        vehicle,
        args.model or preset.model,
        sought,
        preset.outputs or None if args.outputs is None else args.outputs,
    )


def _sought(args: argparse.Namespace, vehicle: Vehicle, names: str) -> list[Sought]:
    """Return the free parameters, with bounds and priors. Raises ConfigError with all issues."""
    from liftgate_hil.config.parameters import find_parameter, same_on_both_sides, value_of
    from liftgate_hil.identify.problem import Sought

    wanted = [each.strip() for each in names.split(",") if each.strip()]
    if not wanted:
        raise ConfigError("--estimate: missing; allowed: keys of the vehicle file, or --preset")
    bounds = fitting.pairs(args.bounds, "--bounds", "KEY=LOW:HIGH, e.g. motor.resistance=0.1:5")
    priors = fitting.pairs(args.prior, "--prior", "KEY=MEAN:STD, e.g. motor.resistance=0.7:0.1")
    issues = []
    found: dict[str, Sought] = {}
    for name in wanted:
        try:
            parameter = find_parameter(vehicle, name)
        except ValueError as error:
            issues.append(f"--estimate {name}: {error}")
            continue
        if name in found:
            issues.append(f"--estimate {name}: given twice; allowed: once")
            continue
        part = name.partition(".")[2]
        if name.startswith(("left.", "right.")) and part in wanted:
            issues.append(f"--estimate {name}: is part of {part}; allowed: one of them")
        if not same_on_both_sides(vehicle, parameter):
            issues.append(f"--estimate {name}: differs between the drives; allowed: left.{name}, right.{name}")
        initial, quantity = value_of(vehicle, parameter), parameter.quantity
        low, high = bounds.pop(name, (quantity.low, quantity.high))
        if not quantity.low <= low < high <= quantity.high:
            issues.append(
                f"--bounds {name}={low:g}:{high:g}: allowed: {quantity.low:g} to {quantity.high:g} "
                f"{quantity.unit}, LOW below HIGH"
            )
        elif not low <= initial <= high:
            issues.append(
                f"--bounds {name}={low:g}:{high:g}: the initial value {initial:g} is outside; allowed: "
                "bounds around it, or another initial value by --set"
            )
        is_known = name in priors
        mean, std = priors.pop(name, (math.nan, math.inf))
        if is_known and not (math.isfinite(mean) and _LEAST_STD <= std < math.inf):
            issues.append(
                f"--prior {name}={mean:g}:{std:g}: allowed: a finite mean, a standard deviation of {_LEAST_STD:g} "
                "or more"
            )
        found[name] = Sought(parameter, initial, low, high, mean, std)
    issues += [f"--bounds {name}: not among --estimate" for name in bounds]
    issues += [f"--prior {name}: not among --estimate" for name in priors]
    if issues:
        raise ConfigError(issues)
    return list(found.values())


def identified(args: argparse.Namespace, report: Report | None = None) -> Identification:
    """Return the result of the identification of these flags; `report` gets its iterations. Raises ConfigError."""
    from liftgate_hil.identify.identification import NothingToTellError, identify
    from liftgate_hil.identify.reporting.findings import notes_of

    if not args.files:
        raise ConfigError("FILE: missing; allowed: one measurement or more, or --plan")
    vehicle, model, sought, outputs = _wanted(args)
    profiles = [each.strip() for each in (args.profile or "").split(",") if each.strip()]
    names = [each.parameter.name for each in sought]
    unknown = [each for each in profiles if each not in names]
    if unknown:
        raise ConfigError([f"--profile {each}: allowed: {', '.join(names)}" for each in unknown])
    problem, notes = fitting.problem_of(args, vehicle, model, sought, outputs)
    try:
        result = identify(problem, report, _noise(args, problem.outputs), profiles)
    except NothingToTellError as error:
        raise ConfigError(
            f"{', '.join(args.files)}: nothing to identify from, with vehicle {args.vehicle}: {error}"
        ) from error
    return dataclasses.replace(result, vehicle=args.vehicle, notes=(*notes, *notes_of(result)))


def _noise(args: argparse.Namespace, columns: Sequence[str]) -> NDArray[np.float64] | None:
    """Return the outputs' noise standard deviations given by --noise; None without it. Raises ConfigError."""
    import numpy as np

    if not args.noise:
        return None
    given: dict[str, float] = {}
    for text in args.noise:
        kind, equals, value = text.partition("=")
        try:
            std = float(value)
        except ValueError:
            std = math.nan
        if kind not in fitting.KINDS or not equals or not 0.0 < std < math.inf:
            raise ConfigError(
                f"--noise {text}: allowed: OUTPUT=STD, OUTPUT one of {', '.join(fitting.KINDS)}, STD above 0"
            )
        given |= dict.fromkeys(fitting.KINDS[kind], std)
    missing = [name for name in columns if name not in given]
    if missing:
        raise ConfigError(f"--noise: not given for {', '.join(missing)}; allowed: all outputs, or none")
    return np.array([given[name] for name in columns])


def _deliver(args: argparse.Namespace, teller: Teller, origin: Provenance, result: Identification) -> None:
    """Print and write the result."""
    from liftgate_hil.identify.reporting.json_result import identification_json
    from liftgate_hil.report.files import write_report

    def text() -> str:
        from liftgate_hil.identify.reporting.text import identification_text

        return identification_text(result)

    def page() -> str:
        from liftgate_hil.identify.reporting.html import identification_html

        return identification_html(result, origin)

    def save() -> None:
        write_report(args.save_vehicle, "--save-vehicle", _vehicle_text(args, result), teller.say)
        kept = [each.name for each in result.parameters if not each.identifiable and not each.is_held]
        if kept:
            teller.say(
                f"{args.save_vehicle}: what is not identifiable has its initial value: {', '.join(kept)}. So this "
                "vehicle is not quite the one that was fitted; liftgate-hil validate shows its fit"
            )

    more = [save] if args.save_vehicle else []
    fitting.deliver(args, teller, origin, identification_json(result), text, page, more)


def _vehicle_text(args: argparse.Namespace, result: Identification) -> str:
    """Return the vehicle file with the estimates.

    What is not identifiable keeps its initial value. What a given bound holds has that bound: the others are
    estimated with it.
    """
    from liftgate_hil.config.settings import settings_of
    from liftgate_hil.config.shipped import find_config
    from liftgate_hil.config.toml import read_toml
    from liftgate_hil.config.variant import settings_for
    from liftgate_hil.config.vehicle_file import vehicle_text
    from liftgate_hil.identify.reporting.json_result import identification_json
    from liftgate_hil.running.setup import variant_of

    identifiable = [k for k, each in enumerate(result.parameters) if each.identifiable]
    content = identification_json(result)
    origin = {
        "model": result.model,
        "files": list(args.files),
        "parameters": [result.parameters[k].name for k in identifiable],
        "values": [result.parameters[k].value for k in identifiable],
        "std": [result.parameters[k].std for k in identifiable],
        "covariance": result.covariance[identifiable][:, identifiable].tolist(),
        "not_identifiable": [each.name for each in result.parameters if not each.identifiable],
        "fit_percent": {key: value for key, value in content["fit_percent"].items() if value is not None},
    }
    values = {each.name: each.value for each in result.parameters if each.identifiable or each.is_held}
    source, variant = find_config("vehicles", args.vehicle), variant_of(args.draw, args.ideal)
    settings = settings_for(read_toml(source), variant, settings_of(args.settings), str(source))
    text = vehicle_text(source, settings, values, origin)
    _check_saved(text, args.save_vehicle, [each.name for each in result.parameters], values)
    return text


def _check_saved(text: str, target: str, sought: Sequence[str], identifiable: Mapping[str, float]) -> None:
    """Check that the loader accepts the vehicle to be saved. Raises ConfigError.

    The loader may refuse it where estimates are not consistent with the initial values of parameters that are not
    identifiable.
    """
    import tomllib

    from liftgate_hil.config.vehicle import vehicle_of

    not_identifiable = [name for name in sought if name not in identifiable]
    try:
        vehicle_of(tomllib.loads(text), f"--save-vehicle {target}")
    except ConfigError as error:
        kept = f"; {', '.join(not_identifiable)} kept the initial value" if not_identifiable else ""
        raise ConfigError(
            [f"{line}{kept}; allowed: --estimate without it, or another --set" for line in error.issues]
        ) from error


def _write_inputs(folder: Path, inputs: Sequence[Path], result: Plan, say: Callable[[str], None]) -> None:
    """Write the inputs of the best sequence, and tell each file. Raises ConfigError, also for one of `inputs`."""
    from liftgate_hil.formats.target import check_no_input
    from liftgate_hil.identify.reporting.plan import input_csv, input_name
    from liftgate_hil.report.files import put_report

    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number, each in enumerate(result.order, 1):
            planned, path = each.candidate, folder / f"{number}-{input_name(each.candidate)}.csv"
            check_no_input(path, inputs)
            put_report(path, input_csv(planned).encode(), say)
            where = f"from rest at {planned.angle_deg:g} deg, road_slope_deg {planned.road_slope_deg:g}"
            say(f"written: {path}: {where}")
    except OSError as error:
        raise ConfigError(f"`save_inputs` {folder}: {error.strerror}; allowed: a folder") from error


def _plan(args: argparse.Namespace, teller: Teller, origin: Provenance) -> int:
    """Rank experiments and report the plan. Raises ConfigError."""
    from liftgate_hil.identify.design import candidates, plan
    from liftgate_hil.identify.reporting.plan import plan_json, plan_text

    issues = ["--plan: takes no FILE; allowed: one or the other"] if args.files else []
    unused = {"--html": args.html, "--save-vehicle": args.save_vehicle, "--profile": args.profile}
    issues += [f"{flag}: not with --plan" for flag, value in unused.items() if value is not None]
    if args.save_inputs == "":
        issues.append("--save-inputs: empty; allowed: a folder")
    if issues:
        raise ConfigError(issues)
    vehicle, model, sought, outputs = _wanted(args)
    given = "current,position" if outputs is None else outputs
    kinds = list(dict.fromkeys(each.strip() for each in given.split(",")))
    unknown = [each for each in kinds if each not in fitting.KINDS]
    if unknown:
        raise ConfigError([f"--outputs {each}: allowed: {', '.join(fitting.KINDS)}" for each in unknown])
    columns = [fitting.KINDS[kind][0] for kind in kinds]
    with teller.progress("plan"):
        result = plan(vehicle, model, sought, columns, candidates(vehicle, args.duration, 1000.0))

    def save() -> None:
        _write_inputs(Path(args.save_inputs), fitting.inputs_of(args), result, teller.say)

    # No page: --html is refused above.
    files = [save] if args.save_inputs is not None else []
    fitting.deliver(args, teller, origin, plan_json(result), lambda: plan_text(result), str, files)
    return 0
