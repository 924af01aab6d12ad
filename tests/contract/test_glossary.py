"""Every term of the glossary is explained and leads to a page; guides link its first use; links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from glossary_links import GLOSSARY, TERMS, linked, unlinked

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", *(ROOT / "datasets").rglob("*.md"), *(ROOT / "reports").rglob("*.md")]
)
ROW = re.compile(r'^\| <a id="([a-z-]+)"></a>(.+?) \| (.+?) \| (.+?) \| (.+?) \|$', re.MULTILINE)


def rows() -> dict[str, re.Match[str]]:
    return {match[1]: match for match in ROW.finditer(GLOSSARY.read_text("utf-8"))}


def test_every_row_of_the_glossary_has_a_name_an_explanation_and_a_page() -> None:
    text, found = GLOSSARY.read_text("utf-8"), rows()
    tables = [line for line in text.splitlines() if line.startswith("| ") and not re.match(r"\| (term|---) ", line)]
    assert len(tables) == len(found), "a row without its own <a id>, or two with one"
    for anchor, row in found.items():
        assert len(row[3]) > 30, f"{anchor}: a term is explained by a sentence"
        assert re.search(r"\]\([\w/.#-]+\)", row[4]), f"{anchor}: no page has more"


def test_what_an_engineer_meets_in_the_first_hour_is_explained() -> None:
    assert {
        "actuation", "ambiguous", "axis", "dataset-version", "drives", "effect", "excitation", "free-run", "gap",
        "held-out-error", "named", "noise-floor", "plant", "recording", "share", "split", "stage", "unnamed",
    } <= rows().keys()  # fmt: skip
    assert TERMS.keys() <= rows().keys()


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "guide").glob("*.md")), ids=lambda page: page.name)
def test_a_guide_links_the_first_use_of_a_term(page: Path) -> None:
    assert unlinked(page.read_text("utf-8")) == {}, f"run: python tests/helpers/glossary_links.py {page.relative_to(ROOT)}"


def test_a_first_use_becomes_a_link() -> None:
    text = (
        "# The plant\nThe `plant` of [a plant](x.md).\nA plant. Each stage, each stage.\n```sh\nfree run\n```\nNoise floors.\n"
    )
    new = linked(text, "glossary.md")
    assert new.count("[stage](glossary.md#stage), each stage.") == 1
    assert "[Noise floors](glossary.md#noise-floor)" in new
    assert "A plant. Each" in new, "its first use is in a link already"
    assert "```sh\nfree run\n```" in new
    assert unlinked(new) == {}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```|`[^`\n]*`", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    lost = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        if not path.exists() or (anchor and anchor not in anchors(path)):
            lost.append(target)
    assert lost == []


def anchors(page: Path) -> set[str]:
    """What a link may name: the headings as GitHub writes them, and what has an id."""
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    slugs = [
        re.sub(r"[^\w\- ]", "", re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower()).replace(" ", "-")
        for heading in headings
    ]
    return {*slugs, *re.findall(r'id="([\w-]+)"', text)}
