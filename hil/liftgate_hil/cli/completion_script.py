"""Completion script of a shell, made from the parsers of all subcommands."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE

# Flags that take a shipped name or a file: the folder of `configs` with the names.
_SHIPPED = {"vehicle": "vehicles", "rig": "rigs", "scenario": "scenarios"}


def script(shell: str) -> str:
    """Return the completion script for a shell of `completion.SHELLS`."""
    import shtab

    from liftgate_hil.cli.main import whole_parser

    root = whole_parser()
    for parser in _with_subparsers(root):
        for action in parser._actions:
            _describe(action)
    return shtab.complete(root, shell)


def _with_subparsers(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """Return a parser and the parsers of all its subcommands, at any depth."""
    children = [
        child
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for child in action.choices.values()
    ]
    return [parser, *(each for child in children for each in _with_subparsers(child))]


def _describe(action: argparse.Action) -> None:
    """Set how shtab completes an argument's values, by the argument's name and metavar."""
    import shtab

    from liftgate_hil.config.shipped import shipped_names

    values: object
    meta = action.metavar if isinstance(action.metavar, str) else ""
    if action.dest in _SHIPPED and "FILE" in meta:
        names = shipped_names(f"configs/{_SHIPPED[action.dest]}")
        values = _words_or_files(action.dest, names, "*.toml")
    elif action.dest == "ecu":
        values = _words_or_files("ecu", (REFERENCE, ON_A_BUS), "*.so")
    elif "FOLDER" in meta or "FILE" in meta:
        values = shtab.DIRECTORY if "FOLDER" in meta else shtab.FILE
    else:
        return
    action.complete = values  # type: ignore[attr-defined]


def _words_or_files(name: str, words: Sequence[str], pattern: str) -> dict[str, object]:
    """Return a completer in shtab's form, which offers words, folders, and files that match a pattern."""
    function, text = f"_liftgate_hil_{name}", " ".join(words)
    bash = f"""
        {function}() {{
          compgen -W "{text}" -- $1
          compgen -f -X "!{pattern}" -- $1
          compgen -d -- $1
        }}
    """
    zsh = f"""
        {function}() {{
          _alternative 'names:shipped:({text})' 'files:file:_files -g "{pattern}"'
        }}
    """
    fish = f"""
        function {function}
          printf '%s\\n' {text}
          __fish_complete_suffix {pattern.removeprefix("*")}
        end
    """
    return {
        "bash": function,
        "zsh": function,
        "fish": f"({function})",
        "preamble": {"bash": bash, "zsh": zsh, "fish": fish},
    }
