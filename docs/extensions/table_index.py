"""Sphinx extension: terms in the first column of reference tables are entries of the index, and of the search.

A page written in Markdown needs no directive for them: its tables are the index.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.transforms import SphinxTransform

# By the head of the first column: the pages whose tables have such terms.
PAGES = {
    "key": ("vehicle", "rig", "scenario", "campaign-file", "map-file"),
    "argument": ("command-line",),
    "subcommand": ("command-line",),
    "kind": ("scenario",),
    "quantity": ("rig", "scenario"),
    "column": ("signals",),
    "signal": ("database",),
    "verdict": ("verdicts",),
}


class TableIndex(SphinxTransform):
    """Adds an index entry, which leads to its row, for each term."""

    default_priority = 700  # before Sphinx collects the entries of a page, at 850

    def apply(self, **_: Any) -> None:
        """Go through the tables of a page."""
        for table in list(self.document.findall(nodes.table)):
            head = next(table.findall(nodes.thead), None)
            body = next(table.findall(nodes.tbody), None)
            if head is None or body is None:
                continue
            name = next(head.findall(nodes.entry)).astext()
            if self.env.docname in PAGES.get(name, ()):
                place = _place_of(table)
                for row in body.findall(nodes.row):
                    self._index(row, place)

    def _index(self, row: nodes.row, place: str) -> None:
        """Give a row an anchor, and its terms entries in the index."""
        cell = next(row.findall(nodes.entry))
        terms = list(_terms_in(cell))
        if not terms:
            return
        anchor = nodes.make_id(f"{place} {terms[0]}") or "row"
        while anchor in self.document.ids:
            anchor += "-x"
        row["ids"].append(anchor)
        self.document.ids[anchor] = row
        entries = [("single", f"{term}; {place}", anchor, "main", None) for term in terms]
        cell.insert(0, addnodes.index(entries=entries))


def _terms_in(cell: nodes.entry) -> Iterator[str]:
    """Yield the terms of a cell: what is set as code, without the values of flags; else its text."""
    literals = [each.astext() for each in cell.findall(nodes.literal)] or [cell.astext()]
    for each in literals:
        term = each.split(" ")[0].rstrip(",")
        if term and ";" not in term and not term.isupper():  # FILE and the like are arguments without a flag
            yield term


def _place_of(table: nodes.table) -> str:
    """Return the titles of the section and the page that a table is in."""
    titles = []
    node = table.parent
    while node is not None:
        if isinstance(node, nodes.section):
            titles.append(next(node.findall(nodes.title)).astext())
        node = node.parent
    return f"{titles[0]}, {titles[-1]}" if len(titles) > 1 else titles[0]


def setup(app: Any) -> dict[str, Any]:
    """Set Sphinx up."""
    app.add_transform(TableIndex)
    return {"version": "1", "parallel_read_safe": True}
