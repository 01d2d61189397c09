"""Report files of a suite: find the requested ones, check that they can be written, write them."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from liftgate_compiler.files import remove_leftovers
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.target import is_one_of
from liftgate_hil.report.files import is_of_another_kind, is_ours, make_way, put_report
from liftgate_hil.testing.junit import issues_as_junit
from liftgate_hil.testing.request import ReportsChoice

Targets = Mapping[str, list[str]]  # files of reports by kind: "json", "junit", "html"; "-" is stdout
_IN_RESULTS = {"json": "verdicts.json", "junit": "junit.xml", "html": "report.html"}  # of a folder of results


def targets_of(choice: ReportsChoice, words: Callable[[str], str] = str, say: Say = silent) -> Targets:
    """Return the report files asked for, by kind: "json", "junit", "html"; "-" is stdout. Raises ConfigError.

    The folder of `results` is created. `words` replaces names of arguments in issues.
    """
    found: Targets = {"json": [], "junit": [], "html": []}
    named = {"json": choice.json, "junit": choice.junit, "html": choice.html}
    wanted = [(kind, str(given)) for kind, given in named.items() if given is not None]
    issues, taken = [], dict[str, str]()  # kinds by their real paths
    if choice.results:
        folder = Path(choice.results)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            issues.append(f"`results` {folder}: {error.strerror}; allowed: a folder")
        else:
            wanted += [(kind, str(folder / name)) for kind, name in _IN_RESULTS.items()]
    for kind, given in wanted:
        issue = _issue_with(kind, given)
        real = given if given == "-" else os.path.realpath(given)
        is_shared = given != "-" and Path(given).exists() and not Path(given).is_file()  # /dev/null
        other = kind if is_shared else taken.setdefault(real, kind)
        if not issue and other != kind:
            issue = f"`{kind}` {given}: another report is written there; allowed: a file of its own"
        if issue:
            issues.append(issue)
        elif real not in map(os.path.realpath, found[kind]):
            found[kind].append(given)
    if issues:
        with reporting_issues(found, words, say):
            raise ConfigError(issues)
    return found


def _issue_with(kind: str, given: str) -> str:
    """Return why a report of a kind cannot be written to a file, or to stdout ("-"); "": it can be."""
    if given == "-":
        if kind == "html":
            return "`html` -: allowed: a file"
        return f"`{kind}` -: stdout is closed; allowed: a file" if sys.stdout is None else ""
    path = Path(given)
    if not path.parent.is_dir():
        return f"`{kind}` {given}: no such folder; allowed: a file in an existing folder"
    if path.is_dir():
        return f"`{kind}` {given}: is a folder; allowed: a file"
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        return f"`{kind}` {given}: cannot be written; allowed: a file that can"
    if is_of_another_kind(path, kind):
        text = "is a file of another kind, which is not replaced"
        return f"`{kind}` {given}: {text}; allowed: a new file, or an earlier report of this kind"
    return ""


def refuse_inputs(targets: Targets, inputs: Iterable[str | Path]) -> None:
    """Remove input files from the report targets; raise ConfigError with their names if there were any."""
    known, issues = [Path(each) for each in inputs], []
    for kind, paths in targets.items():
        for given in [each for each in paths if each != "-" and is_one_of(Path(each), known)]:
            paths.remove(given)
            issues.append(f"`{kind}` {given}: is an input file; allowed: another file")
    if issues:
        raise ConfigError(issues)


@contextlib.contextmanager
def reporting_issues(targets: Targets, words: Callable[[str], str] = str, say: Say = silent) -> Iterator[None]:
    """Context that writes a ConfigError over earlier results in JUnit files, and raises it.

    `words` replaces names of arguments in issues, e.g. by command-line options. Earlier files of the other kinds
    are removed; what is no file, such as /dev/null, stays. Another program's file in the place of a JUnit file is
    renamed.
    """
    try:
        yield
    except ConfigError as error:
        content = issues_as_junit([words(each) for each in error.issues])
        write_all(targets, {"junit": lambda: content}, say=say)
        remove_earlier({**targets, "junit": []})
        raise


def remove_earlier(targets: Targets) -> None:
    """Remove this program's earlier reports at the targets: a killed run would seem to have written them.

    What killed processes have left beside them is removed, too.
    """
    for path in _files_in(targets):
        if path.is_file() and is_ours(path):
            with contextlib.suppress(OSError):
                Path(os.path.realpath(path)).unlink()
        remove_leftovers(path.parent, path.name)


def clear_the_way(targets: Targets, say: Say) -> None:
    """Remove this program's earlier reports at the targets; rename other files there, reported to `say`.

    Raises ConfigError.
    """
    remove_earlier(targets)
    for path in _files_in(targets):
        make_way(path, say)


def _files_in(targets: Targets) -> list[Path]:
    return [Path(each) for paths in targets.values() for each in paths if each != "-"]


def write_all(
    targets: Targets,
    contents: Mapping[str, Callable[[], bytes]],
    put: Callable[[str], None] = print,
    say: Say = silent,
) -> None:
    """Write the bytes that each kind's function in `contents` returns to all targets of it, to "-" by `put`.

    Raises ConfigError with all files that could not be written, after the others have been.
    """
    issues, pairs = [], []
    for kind, content_of in contents.items():
        content = content_of() if targets[kind] else b""
        pairs += [(target, content) for target in targets[kind]]
    for target, content in sorted(pairs, key=lambda pair: pair[0] == "-"):  # files first: stdout may be closed
        try:
            _write(target, content, put, say)
        except ConfigError as error:
            issues += error.issues
    if issues:
        raise ConfigError(issues)


def _write(target: str, content: bytes, put: Callable[[str], None], say: Say) -> None:
    if target == "-":
        put(content.decode())
        return
    try:
        put_report(Path(target), content, say)
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error
