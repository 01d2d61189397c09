"""Flags of the commands that report verdicts, and where their reports go."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.cli import streams
from liftgate_hil.cli.options import as_flags
from liftgate_hil.errors import ConfigError, number_of, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from liftgate_hil.formats.guarded import Say
    from liftgate_hil.testing.suite import Outcome


_IN_RESULTS = {"json": "verdicts.json", "junit": "junit.xml", "html": "report.html"}  # files of --results


class Output:
    """Lines to stdout; where nobody takes them, the program goes on, so that its reports are written."""

    def __init__(self) -> None:
        self._lost: OSError | None = None

    def put(self, lines: Iterable[str]) -> None:
        """Print lines at once."""
        text = "\n".join(lines)
        if text and self._lost is None:
            try:
                print(text, flush=True)
            except OSError as error:
                self._lost = error
                streams.abandon(sys.stdout)

    def raise_if_lost(self) -> None:
        """Raise the error with which stdout was lost: ConfigError, or BrokenPipeError where nobody reads."""
        if self._lost is not None and not isinstance(self._lost, BrokenPipeError):
            raise ConfigError(f"stdout: {self._lost.strerror}") from self._lost
        if self._lost is not None:
            raise self._lost


def add_reports(parser: argparse.ArgumentParser, and_what: str) -> None:
    """Add the flags for reports; `and_what` describes what else is in a folder of results."""
    parser.add_argument("--json", metavar="FILE", help="write the verdicts as JSON; -: to stdout")
    parser.add_argument("--junit", metavar="FILE", help="write the verdicts as JUnit XML")
    parser.add_argument("--html", metavar="FILE", help="write a report with pictures: one file for any browser")
    parser.add_argument("--results", metavar="FOLDER", help=f"write all three into this folder{and_what}")


def targets_of(args: argparse.Namespace) -> dict[str, list[str]]:
    """Return the files of each kind of report, "json", "junit" and "html"; "-" is stdout. Raises ConfigError.

    The folder of `--results` is created.
    """
    found: dict[str, list[str]] = {"json": [], "junit": [], "html": []}
    wanted = [("json", args.json), ("junit", args.junit), ("html", args.html)]
    issues, taken = [], dict[str, str]()  # kinds by their real paths
    if args.results:
        folder = Path(args.results)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            issues.append(f"`results` {folder}: {error.strerror}; allowed: a folder")
        else:
            wanted += [(kind, str(folder / name)) for kind, name in _IN_RESULTS.items()]
    for kind, given in wanted:
        if given is None:
            continue
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
        with reporting_issues(found):
            raise ConfigError(issues)
    return found


def _issue_with(kind: str, given: str) -> str:
    """Return why a report of a kind cannot be written to a file, "-": stdout; "": it can."""
    if given == "-":
        if kind == "html":
            return "`html` -: allowed: a file"
        return f"`{kind}` -: stdout is closed; allowed: a file" if sys.stdout is None else ""
    from liftgate_hil.report.files import is_of_another_kind

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


def refuse_inputs(targets: Mapping[str, list[str]], inputs: Iterable[str | Path]) -> None:
    """Take away the targets that are files to be read, and raise ConfigError with them, if there are any."""
    from liftgate_hil.formats.target import is_one_of

    known, issues = [Path(each) for each in inputs], []
    for kind, paths in targets.items():
        for given in [each for each in paths if each != "-" and is_one_of(Path(each), known)]:
            paths.remove(given)
            issues.append(f"`{kind}` {given}: is an input file; allowed: another file")
    if issues:
        raise ConfigError(issues)


@contextlib.contextmanager
def reporting_issues(targets: Mapping[str, list[str]]) -> Iterator[None]:
    """Context that writes a ConfigError into the JUnit files: earlier, green ones would be taken for its result.

    Earlier files of the other kinds are removed; what is no file, such as /dev/null, stays. What is not ours in
    the place of a JUnit file is set aside.
    """
    try:
        yield
    except ConfigError as error:
        from liftgate_hil.testing.junit import issues_as_junit

        content = issues_as_junit([as_flags(each) for each in error.issues])
        write_all(targets, {"junit": lambda: content})
        remove_earlier({**targets, "junit": []})
        raise


def remove_earlier(targets: Mapping[str, list[str]]) -> None:
    """Remove earlier reports of ours: a run that is killed would leave them as its own. All else stays.

    What killed processes have left beside them is removed, too.
    """
    from liftgate_hil.report.ours import is_ours
    from liftgate_plant.compiler.files import remove_leftovers

    for path in _files_in(targets):
        if path.is_file() and is_ours(path):
            with contextlib.suppress(OSError):
                Path(os.path.realpath(path)).unlink()
        remove_leftovers(path.parent, path.name)


def clear_the_way(targets: Mapping[str, list[str]], say: Say) -> None:
    """Remove earlier reports of ours, and set aside other content of their places, which `say` is told.

    Raises ConfigError.
    """
    from liftgate_hil.report.files import make_way

    remove_earlier(targets)
    for path in _files_in(targets):
        make_way(path, say)


def _files_in(targets: Mapping[str, list[str]]) -> list[Path]:
    return [Path(each) for paths in targets.values() for each in paths if each != "-"]


def report_flags(arguments: Sequence[str], message: str) -> None:
    """Write an error of the flags, which could not be parsed, into the reports that they name; see above."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    for name in ("json", "junit", "html", "results"):
        parser.add_argument(f"--{name}", nargs="?")  # the value may be what is missing
    with contextlib.suppress(argparse.ArgumentError, ConfigError):
        args, _ = parser.parse_known_args(arguments)
        others = list(arguments)
        for given in (args.json, args.junit, args.html):
            if given in others:
                others.remove(given)
        targets = targets_of(args)
        with reporting_issues(targets):
            refuse_inputs(targets, others)
            raise ConfigError(message)


def write_all(targets: Mapping[str, list[str]], contents: Mapping[str, Callable[[], bytes]]) -> None:
    """Write the contents by their kinds, each into all files of its kind, or to stdout (-).

    Raises ConfigError with all files that could not be written, after the others have been.
    """
    issues, pairs = [], []
    for kind, content_of in contents.items():
        content = content_of() if targets[kind] else b""
        pairs += [(target, content) for target in targets[kind]]
    for target, content in sorted(pairs, key=lambda pair: pair[0] == "-"):  # files first: stdout may be closed
        try:
            _write(target, content)
        except ConfigError as error:
            issues += error.issues
    if issues:
        raise ConfigError(issues)


def _tell(text: str) -> None:
    if sys.stderr is not None:
        print(printable(text), file=sys.stderr)


def _write(target: str, content: bytes) -> None:
    if target == "-":
        out = Output()
        out.put([content.decode()])
        out.raise_if_lost()
        return
    from liftgate_hil.report.files import put_report

    try:
        put_report(Path(target), content, _tell)
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error


def summary_of(outcomes: Sequence[Outcome], args: argparse.Namespace, what: str) -> list[str]:
    """Return the last line: how many expectations have which verdict; [] if JSON goes to stdout.

    `what` names what was judged, in the plural: "scenarios", "recordings".
    """
    from liftgate_hil.testing.suite import counts_of

    if args.json == "-":
        return []
    counts: dict[str, Any] = counts_of(outcomes)
    share = counts.pop("inconclusive_share")
    text = ", ".join(f"{number} {name}" for name, number in counts.items() if number)
    runs = number_of(len(outcomes), what.removesuffix("s"))
    judged = number_of(sum(counts.values()), "expectation")
    return [f"{runs}, {judged}: {text}; {100.0 * share:.0f} % inconclusive"]
