"""Configuration of the manual for Sphinx: `make manual`."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from liftgate_hil import version as versions

EXTENSIONS = Path(__file__).parent / "extensions"
sys.path.insert(0, str(EXTENSIONS))

project = "liftgate-hil"
author = "the authors of liftgate-hil"
release = versions.version()
extensions = ["myst_parser", "sphinx.ext.autodoc", "table_index", "search_from_disk"]
exclude_patterns = ["examples", "extensions"]
html_theme = "furo"
html_title = f"liftgate-hil {release}"
html_extra_path = ["trap-matrix.html"]
html_search_scorer = str(EXTENSIONS / "scorer.js")
man_pages = [("command-line", "liftgate-hil", "emulator of an electrically powered lift gate", [], 1)]
html_copy_source = html_show_sourcelink = False

_INTO_THE_CHECKOUT = re.compile(r"\[([^\]]+)\]\((?:\.\./|examples)[^)]*\)")


def without_links_into_the_checkout(app: Any, name: str, source: list[str]) -> None:
    """Leave the text of links to code and examples: the manual is read without the checkout, too."""
    source[0] = _INTO_THE_CHECKOUT.sub(r"\1", source[0])


def setup(app: Any) -> None:
    """Set Sphinx up."""
    app.connect("source-read", without_links_into_the_checkout)
