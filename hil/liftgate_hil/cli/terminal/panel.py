"""Live panel on the terminal with the status of a run: time, gate, motors, command and frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

    from liftgate_hil.loop.listener import RunStatus

_ROOMY = 64  # columns from which bars have words at their ends
_NAMES = 9  # columns of the names, with a gap
_WARNING, _NAME = "bold yellow", "dim"


class PanelView(NamedTuple):
    """Settings of the panel: angle of the open gate, duration, number of drives, delay before it appears."""

    open_deg: float = 90.0  # angle of the open gate
    duration_s: float | None = None  # None: until stopped
    drives: int = 2
    after_s: float = 0.0  # a run that ends earlier is not shown


def panel_of(status: RunStatus, view: PanelView, width: int) -> RenderableType:
    """Return the panel of a run's status, for a terminal of `width` columns."""
    from rich.console import Group

    left, right, age_s = status.left_current_a, status.right_current_a, status.command_age_s
    motors = [f"{left:.2f} A"] if view.drives == 1 else [f"left {left:6.2f} A", f"right {right:6.2f} A"]
    lines = [
        _line("motors", [(text, "") for text in motors]),
        _line("command", [("no command", _WARNING) if age_s is None else (f"{1e3 * age_s:.0f} ms old", "")]),
        _line("frames", [(f"{status.accepted} accepted", ""), (f"{status.sent} sent", "")]),
    ]
    wrong = _wrong(status)
    if wrong:
        lines.append(_line("" if width >= _ROOMY else None, wrong))
    return Group(_bars(status, view, width >= _ROOMY), *lines)


def _bars(status: RunStatus, view: PanelView, is_roomy: bool) -> RenderableType:
    """Return the panel's lines of time and gate angle, each with its bar."""
    from rich.progress_bar import ProgressBar
    from rich.table import Table

    table = Table.grid(padding=(0, 1, 0, 0), expand=True)
    table.add_column(style=_NAME, width=_NAMES - 1, no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_column(style=_NAME, justify="right", no_wrap=True)
    table.add_column(ratio=1)
    table.add_column(style=_NAME, no_wrap=True)

    def add(name: str, value: str, share: float | None, low: str, high: str) -> None:
        ends = (f" {low}", high) if is_roomy else ("", "")
        if share is None:
            table.add_row(name, value)
            return
        bar = ProgressBar(1.0, min(max(share, 0.0), 1.0), complete_style="cyan", finished_style="cyan")
        table.add_row(name, value, ends[0], bar, ends[1])

    whole = view.duration_s
    share = status.time_s / whole if whole else None
    add("time", f"{status.time_s:.1f} s  ", share, "0", f"{whole:g} s" if whole else "")
    add("gate", f"{status.angle_deg:.2f} deg", status.angle_deg / view.open_deg, "closed", "open")
    return table


def _line(name: str | None, parts: list[tuple[str, str]]) -> Text:
    """Return a panel line of parts (text, style); without a name the parts begin at the left edge."""
    from rich.text import Text

    line = Text(no_wrap=True, overflow="ellipsis")
    line.append("" if name is None else name.ljust(_NAMES), _NAME)
    for place, (part, style) in enumerate(parts):
        line.append("  " if place else "").append(part, style)
    return line


def _wrong(status: RunStatus) -> list[tuple[str, str]]:
    """Return the panel's error counts that are not zero, each with its style."""
    counts = (
        ("overruns", status.overruns),
        ("not sent", status.unsent),
        ("rejected", status.rejected),
        ("foreign", status.foreign),
    )
    return [(f"{count} {name}", _WARNING) for name, count in counts if count]
