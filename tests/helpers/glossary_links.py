"""The first use of a term of the glossary on a page is a link.

python tests/helpers/glossary_links.py docs/guide/*.md      (makes it one where it is not)
"""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path

GLOSSARY = Path(__file__).parents[2] / "docs" / "glossary.md"
#: Anchor of the glossary → how the term appears in prose. Everyday words are as narrow as their technical use.
TERMS = {
    "dataset-version": r"dataset versions?",
    "split": r"held[- ]out|(?:fit|selection) recordings?",
    "plant": r"plants?",
    "stage": r"stages?",
    "free-run": r"free[- ]runs?",
    "gap": r"gap (?:analysis|workflow)|the gap",
    "share": r"shares? of (?:the|its) (?:\w+ )?(?:gap|error)",
    "noise-floor": r"noise floors?",
    "excitation": r"excitation|excites?",
}
#: Markdown that gets no links: code blocks (fenced or indented), inline code, headings, comments, link targets, images.
_OTHER = re.compile(r"^```.*?^```|(?<=\n\n)(?: {4}[^\n]*\n)+|`[^`\n]*`|^#.*?$|<!--.*?-->|\]\([^)]*\)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[[^\[\]]*\]\([^)]*\)")


def unlinked(text: str) -> dict[str, tuple[int, int]]:
    """Term → place of its first use in ``text``, where that is no part of a link."""
    prose = _OTHER.sub(lambda match: " " * len(match[0]), text)
    links = [match.span() for match in _LINK.finditer(text)]
    found = {}
    for term, words in TERMS.items():
        first = re.search(rf"\b(?:{words})\b", prose, re.IGNORECASE)
        if first is not None and not any(begin <= first.start() < end for begin, end in links):
            found[term] = first.span()
    return found


def linked(text: str, glossary: str) -> str:
    """``text`` with these first uses made links to the page ``glossary``; overlapping terms one after the other."""
    while places := unlinked(text):
        term, (begin, end) = max(places.items(), key=lambda item: item[1])
        text = f"{text[:begin]}[{text[begin:end]}]({glossary}#{term}){text[end:]}"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", type=Path, nargs="+")
    for page in parser.parse_args().pages:
        text = page.read_text("utf-8")
        page.write_text(linked(text, os.path.relpath(GLOSSARY, page.resolve().parent)), "utf-8")


if __name__ == "__main__":
    main()
