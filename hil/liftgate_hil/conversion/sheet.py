"""Common layout of plots of recordings and vehicles: sizes, fonts, legends, captions, files."""

from __future__ import annotations

import contextlib
import io
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.suffixes import PICTURES
from liftgate_hil.report.drawing import new_figure, pdf, png, style, svg
from liftgate_hil.report.files import SOFTWARE, check_targets, put_report
from liftgate_hil.report.numbers import clean
from liftgate_hil.report.page import figure as figure_html
from liftgate_hil.report.page import page

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

WIDTH, HEIGHT = 11.0, 2.1  # inch, of a panel
FONT, SMALL = 10.0, 9.0
_DPI = 110
_LINE = 140  # characters of a caption's line at WIDTH


def check_picture(name: str, sources: Sequence[str | Path]) -> Path:
    """Return the path of a picture to write, validated. Raises ConfigError if none can be written there."""
    if Path(name).suffix.lower() not in PICTURES:
        raise ConfigError(f"`output` {name}: allowed: a file of {', '.join(PICTURES)}")
    check_targets({"output": name}, sources)
    return Path(name)


@contextlib.contextmanager
def sheet(height: float, title: str, width: float = WIDTH, is_spaced: bool = False) -> Iterator[Figure]:
    """Context that yields a figure of a size [inch] in common fonts; `is_spaced`: blank line below the title."""
    import matplotlib

    with style():
        matplotlib.rcParams.update(
            {"font.size": FONT, "axes.labelsize": FONT, "axes.titlesize": FONT, "legend.fontsize": FONT}
        )
        figure = new_figure(height, width)
        if title:
            figure.suptitle(clean(title, 90) + "\n" * is_spaced, fontsize=FONT + 2.0)
        yield figure


def finish(figure: Figure, caption: str = "") -> None:
    """Align the labels of a drawn figure and write a caption below it."""
    from matplotlib.axes import Axes

    figure.align_ylabels()
    for axis in figure.findobj(Axes):
        axis.tick_params(labelsize=FONT)  # tick labels are created when drawn
    if caption:
        lines = textwrap.fill(clean(caption), round(_LINE * figure.get_figwidth() / WIDTH))
        figure.supxlabel(lines, x=0.01, ha="left", fontsize=SMALL)


def legend_above(axis: Axes, handles: list[Any] | None = None, columns: int = 5) -> Legend:
    """Put the legend above the axes, where it covers no curve, and return it.

    `handles`: with those of another axis; `columns`: entries of a line.
    """
    shown = axis.get_legend_handles_labels()[0] if handles is None else handles
    return axis.legend(
        handles=shown,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=min(columns, max(len(shown), 1)),
        borderaxespad=0.2,
        handlelength=2.8,
    )


def write_picture(path: Path, figure: Figure, title: str, caption: str, say: Say = silent) -> None:
    """Write the figure in the format of its suffix, one of PICTURES; a foreign file is set aside.

    Raises ConfigError if it cannot be written.
    """
    try:
        put_report(path, _drawn_as(path.suffix.lower(), figure, title, caption), say)
    except OSError as error:
        raise ConfigError(f"`output` {path}: cannot be written: {error.strerror}") from error


def _drawn_as(suffix: str, figure: Figure, title: str, caption: str) -> bytes:
    """Return a figure, with title and caption, as a file's content in the format of a suffix, or HTML."""
    if suffix == ".png":
        return png(figure, _DPI)
    if suffix == ".pdf":
        return pdf(figure)
    if suffix == ".svg":
        stream = io.BytesIO()
        with style():
            about = {**dict.fromkeys(("Date", "Format", "Type")), "Creator": SOFTWARE}
            figure.savefig(stream, format="svg", metadata=about, facecolor="white")
        return stream.getvalue()
    return page(title, "", [figure_html(svg(figure, "picture", title), caption)]).encode()
