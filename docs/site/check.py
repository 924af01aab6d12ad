"""What must not be on a page of the documentation site: Markdown that was not rendered."""

from __future__ import annotations

import re
from html.parser import HTMLParser

#: Code as it is written in Markdown: fenced blocks, then spans.
FENCED = re.compile(r"^ *(```+|~~~+).*?^ *\1 *$", re.MULTILINE | re.DOTALL)
_HEADING = re.compile(r"^#{1,6} +\S", re.MULTILINE)
_MARKS = re.compile(r"```|~~~")
_ROW = re.compile(r"^\s*\|.*\|\s*$", re.MULTILINE)


class _Texts(HTMLParser):
    """Prose, code and number of headings of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.prose, self.code, self.headings = "", "", 0
        self._inside = 0
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._inside += tag in ("pre", "code", "script", "style")
        self.headings += re.fullmatch("h[1-6]", tag) is not None

    def handle_endtag(self, tag: str) -> None:
        self._inside -= tag in ("pre", "code", "script", "style")

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.code += data
        else:
            self.prose += data


def faults(html: str, markdown: str) -> list[str]:
    """What of ``markdown`` was not rendered in ``html``, the content of its page; empty where all was."""
    texts = _Texts(html)
    found = [f"a fence that begins no block: {line}" for line in _lines(_MARKS, texts.prose + texts.code)]
    found += [f"a row of no table: {line}" for line in _lines(_ROW, texts.prose)]
    found += [f"an escaped bar: {line}" for line in _lines(re.compile(r"\\\|"), texts.prose + texts.code)]
    wanted = len(_HEADING.findall(FENCED.sub("", markdown)))
    if texts.headings < wanted:
        found.append(f"{wanted - texts.headings} of {wanted} headings are text or code")
    return found


def _lines(pattern: re.Pattern[str], text: str) -> list[str]:
    return [line.strip()[:80] for line in text.splitlines() if pattern.search(line)]
