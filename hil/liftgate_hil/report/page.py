"""HTML page of a report: one self-contained file, light and dark, for screen and paper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from liftgate_hil.described_result import Column
from liftgate_hil.report.numbers import clean

_CSS = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #1c2126; --soft: #5a636e; --grid: #d9dde2;
  --measured: #8c939c; --final: #0072b2; --initial: #d55e00; --mark: #009e73; --alert: #fff3e6; --bar: #d55e00; }
@media (prefers-color-scheme: dark) { :root { --paper: #14181d; --ink: #e6e9ed; --soft: #a3acb7;
  --grid: #333a43; --measured: #7f8893; --final: #56b4e9; --initial: #f0923b; --mark: #2fc79c;
  --alert: #33261a; } }
body { background: var(--paper); color: var(--ink); font: 15px/1.5 system-ui, sans-serif;
  max-width: 58rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; margin: 0 0 .2rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; overflow-wrap: anywhere; }
p.soft, figcaption, td.soft { color: var(--soft); } figcaption, p.soft { font-size: .88rem; }
.alert { background: var(--alert); border-left: 4px solid var(--bar); padding: .5rem 1rem; }
.alert ul { margin: .2rem 0; padding-left: 1.1rem; } li { overflow-wrap: anywhere; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem .25rem 0; text-align: left; vertical-align: top; }
th { font-weight: 600; border-bottom: 1px solid var(--measured); }
td { border-bottom: 1px solid var(--grid); } .r { text-align: right; white-space: nowrap; }
td.name { overflow-wrap: anywhere; min-width: 9rem; }
td.n { white-space: nowrap; } td.soft { min-width: 11rem; }
table.pairs td { overflow-wrap: anywhere; }
table.pairs td:first-child { white-space: nowrap; color: var(--soft); }
figure { margin: .8rem 0 1.4rem; } figure.small { max-width: 36rem; }
svg.plot { display: block; width: 100%; height: auto; } svg.plot * { stroke-linejoin: round; }
@media (max-width: 600px) { figure:not(.small) svg.plot { min-width: 40rem; }
  td:not(.n, .r, .none, .over) { min-width: 6rem; } table.pairs td:first-child, .heat td { min-width: 0; } }
svg.plot text { font-family: system-ui, sans-serif !important; }
@page { margin: 15mm; }
@media print { :root { color-scheme: light; --paper: #ffffff; --ink: #1c2126; --soft: #5a636e;
  --grid: #d9dde2; --measured: #8c939c; --final: #0072b2; --initial: #d55e00; --mark: #009e73; --alert: #ffffff; }
  html { font-size: 11px; } body { margin: 0; max-width: none; font-size: 11px; padding: 0; }
  figure, tr, .alert { break-inside: avoid; } h2, h3 { break-after: avoid; } .wide { overflow: visible; } }
"""
GENERATOR = '<meta name="generator" content="liftgate-hil">'  # near the beginning of each report
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


class Markup(str):
    """Text that is HTML already, and is not escaped."""

    __slots__ = ()


def page(title: str, subtitle: str, sections: Iterable[str], style: str = "") -> str:
    """Return a whole HTML page from title and subtitle as text, sections as HTML, and additional CSS (`style`)."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"{GENERATOR}\n"
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{text(title)}</title>\n<style>{_CSS}{style}</style>\n</head>\n<body>\n<main>\n"
        f'<h1>{text(title)}</h1>\n<p class="soft">{text(subtitle)}</p>\n'
        + "\n".join(each for each in sections if each)
        + "\n</main>\n</body>\n</html>\n"
    )


def text(content: str) -> str:
    """Return a text, after `clean`, escaped for HTML elements and quoted attributes; Markup stays as it is."""
    return content if isinstance(content, Markup) else escape(clean(content))


def section(title: str, *parts: str) -> str:
    """Return an HTML section with a heading; empty where all its parts are empty."""
    kept = [part for part in parts if part]
    return "\n".join([f"<h2>{text(title)}</h2>", *kept]) if kept else ""


def subheading(title: str) -> str:
    """Return a subheading in HTML."""
    return f"<h3>{text(title)}</h3>"


def bullets(texts: Sequence[str]) -> str:
    """Return an HTML list with bullets; empty where there are no texts."""
    if not texts:
        return ""
    return "<ul>\n" + "\n".join(f"<li>{text(each)}</li>" for each in texts) + "\n</ul>"


def alert(texts: Sequence[str]) -> str:
    """Return a highlighted HTML list, for texts that must not be overlooked; empty where there are none."""
    return f'<div class="alert" role="note">\n{bullets(texts)}\n</div>' if texts else ""


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], classes: Sequence[str]) -> str:
    """Return an HTML table of texts or Markup; `classes` has each column's CSS class; empty without rows."""
    if not rows:
        return ""

    def cell(content: str, name: str, tag: str) -> str:
        tag = tag if content else "td"  # a column without a head
        return f'<{tag} class="{name}">{text(content)}</{tag}>' if name else f"<{tag}>{text(content)}</{tag}>"

    def row(cells: Sequence[str], tag: str) -> str:
        return f"<tr>{''.join(cell(each, name, tag) for each, name in zip(cells, classes, strict=True))}</tr>"

    body, label = "\n".join(row(each, "td") for each in rows), ", ".join(filter(None, heads))
    return (  # a table that is wider than the screen is scrolled, with the keyboard too
        f'<div class="wide" tabindex="0" role="group" aria-label="table: {text(label)}"><table>\n'
        f"<thead>{row(heads, 'th')}</thead>\n<tbody>\n{body}\n</tbody>\n</table></div>"
    )


def table_of(columns: Sequence[Column], results: Sequence[object]) -> str:
    """Return an HTML table of results by their columns; empty without results."""
    rows = [[column.cell(each) for column in columns] for each in results]
    return table([each.head for each in columns], rows, [each.look for each in columns])


def pairs(rows: Sequence[tuple[str, str]]) -> str:
    """Return an HTML table of (name, value), texts or Markup, without a header; empty without rows."""
    if not rows:
        return ""
    body = "\n".join(f"<tr><td>{text(name)}</td><td>{text(value)}</td></tr>" for name, value in rows)
    return f'<div class="wide"><table class="pairs">\n{body}\n</table></div>'


def figure(drawing: str, caption: str, *, small: bool = False) -> str:
    """Return an HTML figure of an SVG drawing with its caption; it scrolls on a phone, to stay readable."""
    kind = ' class="small"' if small else ""
    label = text(f"picture: {caption}" if caption else "picture")
    frame = f'<div class="wide" tabindex="0" role="group" aria-label="{label}">\n{drawing}</div>\n'
    below = f"<figcaption>{text(caption)}</figcaption>\n" if caption else ""
    return f"<figure{kind}>\n{frame}{below}</figure>"
