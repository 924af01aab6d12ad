"""The lineage as an SVG drawing whose boxes link to the pages of the items."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import networkx as nx
from markupsafe import Markup

from sysid.registry import CHAMPION
from sysid.site.graph import layers, positions, with_waypoints
from sysid.site.item import Item

#: Size of a box, and distances of their left upper corners [px].
WIDTH, HEIGHT, COLUMN, ROW = 182.0, 58.0, 214.0, 74.0
MARGIN = 10.0
#: Characters that fit into a box.
LONGEST = 23


def drawing(graph: nx.DiGraph[str], items: Mapping[str, Item], up: str = "", here: str = "") -> Markup:
    """The items of ``graph`` as boxes, arrows from source to product.

    Args:
        items: by key.
        up: path from the page to the root of the site (``../``).
        here: key of the item whose page it is.
    """
    whole, ways = with_waypoints(graph)
    found = layers(whole)
    if not found:
        return Markup("")
    rows = positions(found)
    top = min(rows.values())
    corner = {
        key: (MARGIN + COLUMN * column, MARGIN + ROW * (rows[key] - top)) for column, layer in enumerate(found) for key in layer
    }
    width = 2.0 * MARGIN + COLUMN * (len(found) - 1) + WIDTH
    height = 2.0 * MARGIN + ROW * (max(rows.values()) - top) + HEIGHT
    parts = [_arrow([corner[key] for key in ways[edge]]) for edge in sorted(graph.edges)]
    parts += [_box(items[key], corner[key], up, key == here) for layer in found for key in layer if key in graph]
    return Markup(
        '<div class="scroll lineage" tabindex="0" role="region" aria-label="Lineage"><svg viewBox="0 0 {w:.0f} {h:.0f}" '
        'style="--width:{w:.0f}px" role="group">{parts}</svg></div>'
    ).format(w=width, h=height, parts=Markup("").join(parts))


def _arrow(way: list[tuple[float, float]]) -> Markup:
    """From the right side of the first box, level through the places of the waypoints, to the left side of the last box."""
    level = HEIGHT / 2.0
    text = f"M{way[0][0] + WIDTH:.0f} {way[0][1] + level:.0f}"
    for (x, y), (end, height) in pairwise(way):
        begin = x + WIDTH
        bend = min(60.0, (end - begin) / 2.0)
        text += f"C{begin + bend:.0f} {y + level:.0f} {end - bend:.0f} {height + level:.0f} {end:.0f} {height + level:.0f}"
        text += f"H{end + WIDTH:.0f}" if (end, height) != way[-1] else "l-7 -4m7 4l-7 4"
    return Markup('<path class="edge" d="{}"/>').format(text)


def _box(item: Item, corner: tuple[float, float], up: str, here: bool) -> Markup:
    champion = CHAMPION in item.aliases
    classes = " ".join(filter(None, ("box", item.kind, "champion" * champion, "here" * here)))
    x, y = corner
    title = f"{item.word} {item.reference}: {item.summary}; content {item.digest[:12]}"
    body = Markup(
        '<title>{}</title><rect x="{:.0f}" y="{:.0f}" width="{:.0f}" height="{:.0f}" rx="6"/>'
        '<rect class="stripe" x="{:.0f}" y="{:.0f}" width="5" height="{:.0f}"/>'
        '<text x="{:.0f}" y="{:.0f}">{}</text><text class="small" x="{:.0f}" y="{:.0f}">{}</text>'
        '<text class="small" x="{:.0f}" y="{:.0f}">{}</text>'
    ).format(
        title, x, y, WIDTH, HEIGHT, x, y + 6.0, HEIGHT - 12.0,
        x + 14.0, y + 20.0, _cut(f"{'★ ' if champion else ''}{item.reference}"),
        x + 14.0, y + 36.0, item.word,
        x + 14.0, y + 50.0, item.digest[:12],
    )  # fmt: skip
    if not item.href:
        return Markup('<g class="{}">{}</g>').format(classes, body)
    current = Markup(' aria-current="page"') if here else ""
    return Markup('<a class="{}" href="{}{}"{}>{}</a>').format(classes, up, item.href, current, body)


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"
