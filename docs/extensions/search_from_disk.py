"""Sphinx extension: the search shows excerpts where the manual is opened as files.

Sphinx's search page fetches each page that it has found, and makes an excerpt of it. A browser does not let a page
that is opened as a file fetch others. So the texts of all pages are in one script, which a page of files may load,
and which answers in their place.
"""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes

SCRIPT = "page-texts.js"
_CODE = """\
/* The texts of all pages, with their anchors; see docs/extensions/search_from_disk.py. */
const PAGE_TEXTS = %s;
const fetchPage = window.fetch;
window.fetch = (url, ...more) => {
  const root = document.documentElement.dataset.content_root;
  const name = String(url).startsWith(root) ? String(url).slice(root.length).replace(/\\.html$/, "") : "";
  const text = Object.hasOwn(PAGE_TEXTS, name) ? PAGE_TEXTS[name] : undefined;
  return text === undefined ? fetchPage(url, ...more) : Promise.resolve(new Response(text));
};
"""
_INVISIBLE = (nodes.comment, nodes.Invisible, nodes.raw, nodes.image)
_APART = (nodes.TextElement, nodes.Structural, nodes.Body)  # what a line or a cell ends with


def text_of(node: nodes.Node) -> str:
    """Return the text of a node as HTML that has the anchors of the page, and nothing else."""
    if isinstance(node, nodes.Text):
        return escape(node)
    if isinstance(node, _INVISIBLE):
        return ""
    inside = "".join(text_of(each) for each in node.children)
    if isinstance(node, _APART) and not isinstance(node, nodes.Inline):
        inside += "\n" if "\n" not in inside[-1:] else ""
    for name in node.get("ids", ()) if isinstance(node, nodes.Element) else ():
        inside = f'<div id="{escape(name)}">{inside}</div>'
    return inside


def add_script(app: Any, name: str, template: str, context: Any, doctree: Any) -> None:
    """Load the script on the search page."""
    if name == "search":
        app.add_js_file(SCRIPT)


def write_script(app: Any, error: Exception | None) -> None:
    """Write the script, once all pages are known."""
    if error is None and app.builder.format == "html":
        texts = {
            name: f'<div role="main">{text_of(app.env.get_doctree(name))}</div>'
            for name in sorted(app.env.found_docs)
        }
        path = Path(app.outdir) / "_static" / SCRIPT
        path.write_text(_CODE % json.dumps(texts, ensure_ascii=False), encoding="utf-8")


def setup(app: Any) -> dict[str, Any]:
    """Set Sphinx up."""
    app.connect("html-page-context", add_script)
    app.connect("build-finished", write_script)
    return {"version": "1", "parallel_read_safe": True}
