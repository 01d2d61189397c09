"""HTML pages, parsed and checked."""

from __future__ import annotations

import re
from html.parser import HTMLParser

VOID = {"meta", "link", "img", "br", "hr", "input"}


class Page(HTMLParser):
    """A parser that checks nesting and collects text, identifiers, references and elements."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.open, self.words, self.ids, self.links, self.tags = [], [], [], [], []
        self.attributes = set()
        self.html = html
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self._note(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self._note(tag, attrs)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.words.append(data)

    def _note(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            self.attributes.add(name)
            if name == "id":
                self.ids.append(value)
            if name in ("href", "xlink:href", "src", "action", "data"):
                self.links.append(value)
            self.links += re.findall(r"url\(([^)]*)\)", value or "")

    def check_alone(self):
        """Check that the page is self-contained, has no script, and that its references have targets."""
        assert len(self.ids) == len(set(self.ids))
        for link in self.links:
            if link.startswith("data:image/png;base64,"):  # a picture in it
                continue
            assert link.startswith("#")
            assert link[1:] in self.ids
        assert not {"script", "iframe", "object", "link", "base", "form"} & set(self.tags)
        assert not [each for each in self.attributes if each.startswith("on")]
        assert not re.search(r"https?:|@import|file:", self.html)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())
