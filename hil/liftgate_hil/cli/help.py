"""Help of a command, for `--help`: first what it needs, then its flags by subject, at the end three examples."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Mapping, Sequence

# Subjects of flags, in their order, by the names of their values. A flag that stands under none has the subject of
# the flag before it.
_SUBJECTS: Mapping[str, tuple[str, ...]] = {
    "bus": ("bus", "serial", "interface", "channel", "bitrate", "is_fd", "rig", "ecu_serial"),
    "ECU": ("ecu", "against", "mutants", "mutation_threshold", "request", "no_requests", "drives", "coding"),
    "vehicle": ("vehicle", "settings", "draw", "ideal"),
    "scenario": ("scenario", "scenarios", "initial", "seed", "set-parameter", "voltage", "input", "one_run"),
    "variants": ("vary", "samples", "method", "sampling_seed", "worst", "evaluations", "probability", "replay"),
    "clock": ("clock", "rate", "duration", "step", "realtime", "cpu", "overrun_limit", "wall_timeout"),
    "what is run": ("jobs", "retry_inconclusive", "scheduler", "store", "resume"),
    "files that are read": (
        *("recording", "maps", "recording_channel", "timezone", "origin", "longest_gap", "from_s"),
        *("to_s", "cut_angle", "resample", "decimate", "drop_outliers", "columns", "direction", "only"),
        "without",
    ),
    "playing": ("speed", "times", "loop"),
    "model": ("model", "outputs", "input_delay", "speed_window", "parameters", "plan"),
    "estimate": ("estimate", "preset", "bounds", "prior", "noise", "profile"),
    "recording": (
        *("record", "record_limit", "record_keep", "record_when", "record_before", "record_after", "recordings"),
        "no_record",
    ),
    "page": ("dashboard", "attach", "listen", "read_only"),
    "results": (
        *("figure", "tolerance", "every", "output", "edges", "result", "results", "save_vehicle", "save_inputs"),
        *("time_tolerance", "json", "junit", "html", "quiet"),
    ),
}
_SUBJECT_OF = {name: subject for subject, names in _SUBJECTS.items() for name in names}
_WIDTH = 108  # characters of a line, where the terminal has as many


class Formatter(argparse.RawDescriptionHelpFormatter):
    """Formatter of help texts with lines as long as the terminal allows, up to `_WIDTH`."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=_width())


@functools.cache  # argparse makes a formatter for each argument
def _width() -> int:
    """Return the length of the longest lines of a help text."""
    import shutil

    return min(_WIDTH, shutil.get_terminal_size().columns - 2)


def arrange(parser: argparse.ArgumentParser, examples: Sequence[str], more: str = "") -> None:
    """Group a command's added arguments by subject in its help; set usage and epilog: `more`, then examples."""
    flags = parser._optionals
    needs = parser._positionals
    subject = ""
    for action in list(flags._group_actions):
        subject = _subject_of(action) or subject
        group = needs if action.required else _group(parser, subject) if subject else flags
        if group is not flags:
            flags._group_actions.remove(action)
            group._group_actions.append(action)
    order = [needs, *(_group(parser, each) for each in _SUBJECTS), flags]
    parser._action_groups[:] = [each for each in order if each._group_actions]
    needs.title, flags.title = "what it needs", "others"
    shown = "\n".join(f"  {each}" for each in examples)
    parser.epilog = "\n\n".join(filter(None, (more, f"examples:\n{shown}" if examples else "")))
    parser.usage = " ".join([parser.prog, *map(_needed, needs._group_actions), "[FLAGS]"])


def _subject_of(action: argparse.Action) -> str:
    """Return the subject that a flag stands under in `_SUBJECTS`; "": it stands in none."""
    flag = action.option_strings[-1].lstrip("-") if action.option_strings else ""
    return _SUBJECT_OF.get(flag) or _SUBJECT_OF.get(action.dest, "")


def _group(parser: argparse.ArgumentParser, title: str) -> argparse._ArgumentGroup:
    """Return the parser's argument group with a title; it is added if it does not exist."""
    found = [each for each in parser._action_groups if each.title == title]
    return found[0] if found else parser.add_argument_group(title)


def _needed(action: argparse.Action) -> str:
    """Return a required argument as the usage line shows it."""
    name = str(action.metavar or action.dest)
    if action.option_strings:
        return f"{action.option_strings[0]} {name}"
    return {"+": f"{name} [{name} ...]", "*": f"[{name} ...]", "?": f"[{name}]"}.get(str(action.nargs), name)
