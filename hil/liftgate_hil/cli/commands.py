"""Commands in the order of the overview: what each does, and examples of it for its `--help` and the manual."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Subcommand(NamedTuple):
    """Summary and examples of a subcommand, which the module of the same name in this folder implements.

    There are three examples at least; the first is the usual one.
    """

    summary: str
    examples: tuple[str, ...]


COMMANDS: Mapping[str, Subcommand] = {
    "run": Subcommand(
        "the real-time emulator on a bus (the default subcommand)",
        (
            "liftgate-hil --bus socketcan:can0",
            "liftgate-hil --ecu reference --dashboard",
            "liftgate-hil --bus socketcan:vcan0 --rig my-rig.toml --scenario pack/crank_dip --record run.mf4",
        ),
    ),
    "demo": Subcommand(
        "the emulator and the reference ECU: opens, meets an obstacle, reverses",
        (
            "liftgate-hil demo",
            "liftgate-hil demo --ecu ./libmy_ecu.so --clock free",
            "liftgate-hil demo --bus socketcan:vcan0 --dashboard",
        ),
    ),
    "ecu": Subcommand(
        "the reference ECU alone, on any bus",
        (
            "liftgate-hil ecu --bus socketcan:vcan0",
            "liftgate-hil ecu --bus socketcan:vcan0 --request 0.5:open --request 13.5:close --duration 30",
            "liftgate-hil ecu --serial /dev/ttyUSB0@921600 --ecu ./libmy_ecu.so",
        ),
    ),
    "test": Subcommand(
        "scenario files: run, judge, report",
        (
            "liftgate-hil test pack",
            "liftgate-hil test pack/crank_dip --ecu ./libmy_ecu.so --html report.html --junit report.xml",
            "liftgate-hil test my-tests --ecu bus --bus socketcan:can0 --clock realtime --retry-inconclusive 2",
        ),
    ),
    "judge": Subcommand(
        "the same verdicts again, from recordings",
        (
            "liftgate-hil judge drive.mf4 --scenario pack/trap_40deg_10npmm",
            "liftgate-hil judge drive.log --scenario my.toml --rig their.dbc --map 'gate_angle_deg=Gate.Angle'",
            "liftgate-hil judge results/*.mf4 --scenario my.toml --html report.html",
        ),
    ),
    "campaign": Subcommand(
        "many variants of a scenario: grid, samples, search for the worst, probability",
        (
            "liftgate-hil campaign my.toml --vary rod=10000,20000,65000 --vary angle=10:70:13 --output grid",
            "liftgate-hil campaign my.toml --vary 'rod~loguniform(5e3,1e5)' --samples 10000 --output samples",
            "liftgate-hil campaign my.toml --vary 'angle~uniform(10,70)' --worst 'turns back' --output worst",
            "liftgate-hil campaign grid --replay VARIANT --record run.mf4",
        ),
    ),
    "convert": Subcommand(
        "a recording in another format; bus logs decoded into tables",
        (
            "liftgate-hil convert run.blf run.mf4",
            "liftgate-hil convert run.mf4 run.csv  # its rows; the frames are left out",
            "liftgate-hil convert run.blf signals.csv --rig liftgate  # what the frames say, decoded",
        ),
    ),
    "replay": Subcommand(
        "a recording's frames onto a bus, with the original timing",
        (
            "liftgate-hil replay run.blf --bus socketcan:can0  # what the gate sent, for the ECU",
            "liftgate-hil replay run.blf --bus socketcan:can0 --direction received  # what reached it, for a gate",
            "liftgate-hil replay car.asc --bus socketcan:can0 --except 0x120,0x7E0-0x7EF",
            "liftgate-hil replay run.mf4 --bus socketcan:can0 --from 13 --to 20 --loop",
        ),
    ),
    "plot": Subcommand(
        "a picture of a recording or of a vehicle",
        (
            "liftgate-hil plot run.csv",
            "liftgate-hil plot run.mf4 --columns left_current_a,sensed_left_current_a --from 12.3 --to 12.6 "
            "--output run.svg",
            "liftgate-hil plot run.blf --rig liftgate --columns Gate.Angle,LeftDrive.MotorCurrent",
            "liftgate-hil plot run.csv --figure phase --output phase.pdf",
            "liftgate-hil plot --figure forces --vehicle suv --set environment.road_slope_deg=8",
        ),
    ),
    "dashboard": Subcommand(
        "the operator's page of a running emulator, or of a recording",
        (
            "liftgate-hil dashboard  # of the emulator that runs here",
            "liftgate-hil dashboard --attach 4711  # of one of several",
            "liftgate-hil dashboard --recording run.mf4",
            "liftgate-hil dashboard --scenarios pack  # which the page starts, with the reference ECU",
        ),
    ),
    "compare": Subcommand(
        "two recordings: the first and the largest difference of each column; a picture",
        (
            "liftgate-hil compare before.csv after.csv",
            "liftgate-hil compare before.mf4 after.mf4 --columns left_current_a --tolerance 0.05",
            "liftgate-hil compare bench.log car.log --rig liftgate --time-tolerance 0.002 --output difference.png",
        ),
    ),
    "simulate": Subcommand(
        "the plant alone, offline, as fast as it goes",
        (
            "liftgate-hil simulate --voltage 12 --duration 8 --output opening.csv",
            "liftgate-hil simulate --initial open --voltage -9 --set environment.road_slope_deg=8 --output s.csv",
            "liftgate-hil simulate --vehicle compact --input measured.csv --output simulated.csv",
        ),
    ),
    "identify": Subcommand(
        "parameters of a vehicle from measurements; which experiment gives most information",
        (
            "liftgate-hil identify measured.csv --estimate motor.resistance,motor.rotor_inertia --html fit.html",
            "liftgate-hil identify drive.mf4 --rig my-rig.toml --preset thesis-1 --save-vehicle my-car.toml",
            "liftgate-hil identify --plan --estimate motor.resistance,friction.coulomb --duration 20",
        ),
    ),
    "validate": Subcommand(
        "a vehicle's model against measurements",
        (
            "liftgate-hil validate measured.csv --vehicle my-car.toml",
            "liftgate-hil validate measured.csv --vehicle suv --parameters result.json",
            "liftgate-hil validate drive.mf4 --rig my-rig.toml --vehicle my-car.toml --html report.html",
        ),
    ),
    "rig": Subcommand(
        "what a rig maps and whether it fits; a first rig for a foreign database",
        (
            "liftgate-hil rig check liftgate",
            "liftgate-hil rig draft their.dbc --output their-rig.toml",
            "liftgate-hil rig check their-rig.toml --vehicle compact",
        ),
    ),
    "init": Subcommand(
        "a folder to start from: database, vehicle, rig, scenario, a test, an ECU in C",
        ("liftgate-hil init my-gate", "liftgate-hil init .", "liftgate-hil init my-gate --quiet"),
    ),
    "compile": Subcommand(
        "the machine code of all loops ahead of time: for container images and CI caches",
        ("liftgate-hil compile", "XDG_CACHE_HOME=/opt/cache liftgate-hil compile", "liftgate-hil compile --quiet"),
    ),
    "completion": Subcommand(
        "a script with which bash, zsh or fish complete flags and names",
        (
            "liftgate-hil completion bash > ~/.local/share/bash-completion/completions/liftgate-hil",
            "liftgate-hil completion zsh > ~/.zfunc/_liftgate-hil",
            "liftgate-hil completion fish > ~/.config/fish/completions/liftgate-hil.fish",
        ),
    ),
    "list": Subcommand(
        "what is shipped, with descriptions: scenarios, vehicles, rigs, campaigns, ECUs",
        ("liftgate-hil list", "liftgate-hil list pack/trap", "liftgate-hil list mutant"),
    ),
    "doctor": Subcommand(
        "is this machine fit for real time: kernel, limits, buses, timer lateness",
        (
            "liftgate-hil doctor",
            "liftgate-hil doctor --rate 2000 --duration 60",
            "liftgate-hil doctor --realtime --cpu 3",
        ),
    ),
}
