"""The pages about the whole workspace: overview, lineage, comparison."""

from __future__ import annotations

import base64
import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from sysid.registry import CHAMPION
from sysid.reports.figures import embed
from sysid.reports.pages import SiteBar, page
from sysid.site.drawing import drawing
from sysid.site.graph import around, lineage_graph
from sysid.site.item import WORDS, Item

FOLDER = Path(__file__).parent
STYLES = ("page.css", "models.css", "site.css")
#: Most boxes of the drawing on the overview.
MOST = 40


def index_page(items: Sequence[Item], workspace: str, created: str) -> str:
    """The overview: what is in use, the lineage, and a table of everything with search, sorting and a choice of two."""
    whole = [item for item in items if item.kind not in ("damaged", "logs")]
    by_key = {item.key: item for item in items if item.kind != "damaged"}
    graph = lineage_graph(by_key.values())
    newest = set(graph) if len(graph) <= MOST else set().union(*(around(graph, item.key) for item in in_use(items)[:5]))
    counts = Counter[str](item.kind for item in whole)
    return page(
        "index.html",
        STYLES,
        FOLDER,
        SiteBar(),
        title=workspace,
        kind="Workspace",
        facts=f"{len(whole)} items · {created}",
        in_use=[_use(item) for item in in_use(items)],
        drawing=drawing(graph.subgraph(newest), by_key),
        more=len(newest) < len(graph),
        count=len(graph),
        kinds=[(kind, WORDS[kind], counts[kind]) for kind in WORDS if counts[kind]],
        rows=[_row(item) for item in whole],
        damaged=[f"{item.reference}: {item.damage}" for item in items if item.kind == "damaged"],
        **_script("site.js"),
    )


def lineage_page(items: Sequence[Item], workspace: str) -> str:
    """All items and their sources."""
    by_key = {item.key: item for item in items if item.kind != "damaged"}
    drawn = drawing(lineage_graph(by_key.values()), by_key)
    return page("lineage.html", STYLES, FOLDER, SiteBar(), title="Lineage", kind="Workspace", facts=workspace, drawing=drawn)


def compare_page(items: Sequence[Item], workspace: str) -> str:
    """Two items side by side; the choice is made on the page."""
    whole = [item for item in items if item.kind not in ("damaged", "logs")]
    groups = [(word, [item for item in whole if item.kind == kind]) for kind, word in WORDS.items()]
    data = {
        item.key: {
            "title": f"{item.word} {item.reference}",
            "href": item.href,
            "facts": [("Content", "content", item.digest[:12]), *((fact.group, fact.name, fact.text) for fact in item.facts)],
        }
        for item in whole
    }
    return page(
        "compare.html",
        STYLES,
        FOLDER,
        SiteBar(),
        title="Compare",
        kind="Workspace",
        facts=workspace,
        groups=[(word, own) for word, own in groups if own],
        data=embed("items", data),
        **_script("compare.js"),
    )


def in_use(items: Sequence[Item]) -> list[Item]:
    """Of each model name the champion, else the newest version: what the name alone means."""
    found: dict[tuple[str, str], list[Item]] = {}
    for item in items:
        if item.kind not in ("damaged", "logs", "dataset", "gap", "flight"):
            found.setdefault((item.kind, item.name), []).append(item)
    return [
        next((item for item in own if CHAMPION in item.aliases), max(own, key=lambda item: int(item.reference.split("@")[-1])))
        for own in found.values()
    ]


def _use(item: Item) -> dict[str, Any]:
    own = {"href": item.href, "reference": f"{item.name} → {item.reference}", "word": item.word, "summary": item.summary}
    return {**own, "promoted": CHAMPION in item.aliases}


def _row(item: Item) -> dict[str, Any]:
    return {
        "kind": item.kind,
        "key": item.key,
        "word": item.word,
        "reference": item.reference,
        "sort": item.reference,
        "href": item.href,
        "aliases": item.aliases,
        "summary": item.summary,
        "created": item.created,
        "digest": item.digest[:12],
        "text": " ".join(_searched(item)).lower(),
    }


def _searched(item: Item) -> Iterator[str]:
    yield from (item.reference, item.word, item.kind, item.summary, item.digest, item.created, *item.aliases)
    for fact in item.facts:
        yield from (fact.name, fact.text)


def _script(name: str) -> dict[str, Any]:
    """A script, and its hash for the page's content security policy, which permits no other."""
    text = (FOLDER / name).read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
    return {"script": Markup(text), "script_hash": f"sha256-{digest}"}
