"""The lineage of items as a layered graph (sources on the left, what was made from them on the right), and as an SVG drawing
whose boxes link to the pages of the items.

Layers and crossings as by Sugiyama, Tagawa and Toda, "Methods for visual understanding of hierarchical system structures", IEEE
Trans. Systems, Man and Cybernetics 11 (1981): each item one layer right of its last source, the order in a layer by the mean
position of its neighbours. A connection over several layers passes each of them at a waypoint of its own and crosses no box.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import networkx as nx
from markupsafe import Markup

from sysid.progress_bar import cut
from sysid.registry import CHAMPION
from sysid.site.item import Item

#: Sweeps over the layers; the order no longer changes after a few.
SWEEPS = 8


def lineage_graph(items: Iterable[Item]) -> nx.DiGraph[str]:
    """Keys of items, an edge from each source; edges that a longer path replaces are left out."""
    graph: nx.DiGraph[str] = nx.DiGraph()
    for item in items:
        graph.add_node(item.key)
        for parent in item.parents:
            graph.add_edge(parent, item.key)
    if not nx.is_directed_acyclic_graph(graph):  # a result that was edited: draw what it states
        return graph
    return nx.transitive_reduction(graph)


def around(graph: nx.DiGraph[str], key: str) -> nx.DiGraph[str]:
    """An item with all of its sources and all that was made from it."""
    return graph.subgraph({key} | nx.ancestors(graph, key) | nx.descendants(graph, key))


def with_waypoints(graph: nx.DiGraph[str]) -> tuple[nx.DiGraph[str], dict[tuple[str, str], list[str]]]:
    """The graph with a node in every layer that an edge passes, and edge → its way: source, waypoints, target."""
    if not nx.is_directed_acyclic_graph(graph):
        return graph, {edge: list(edge) for edge in graph.edges}
    column = {key: number for number, layer in enumerate(nx.topological_generations(graph)) for key in layer}
    ways = {
        (source, target): [source, *(f"{source}\n{target}\n{at}" for at in range(column[source] + 1, column[target])), target]
        for source, target in graph.edges
    }
    whole: nx.DiGraph[str] = nx.DiGraph()
    whole.add_nodes_from(graph)
    for way in ways.values():
        whole.add_edges_from(pairwise(way))
    return whole, ways


def layers(graph: nx.DiGraph[str]) -> list[list[str]]:
    """Keys by layer, in the order in which they are drawn from top to bottom."""
    if not nx.is_directed_acyclic_graph(graph):
        return [sorted(graph)]
    found = [sorted(layer) for layer in nx.topological_generations(graph)]
    for sweep in range(SWEEPS):
        forward = sweep % 2 == 0
        for number in range(len(found)) if forward else reversed(range(len(found))):
            neighbours = graph.pred if forward else graph.succ
            place = positions(found)
            found[number] = _ordered(found[number], neighbours, place)
    return found


def positions(found: Sequence[Sequence[str]]) -> dict[str, float]:
    """Key → vertical position, each layer centred at zero."""
    return {key: row - (len(layer) - 1) / 2.0 for layer in found for row, key in enumerate(layer)}


def _ordered(layer: Sequence[str], neighbours: Mapping[str, Iterable[str]], place: Mapping[str, float]) -> list[str]:
    def mean(key: str) -> float:
        around_it = [place[other] for other in neighbours[key]]
        return sum(around_it) / len(around_it) if around_it else place[key]

    return sorted(layer, key=lambda key: (mean(key), key))


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
        x + 14.0, y + 20.0, cut(f"{'★ ' if champion else ''}{item.reference}", LONGEST),
        x + 14.0, y + 36.0, item.word,
        x + 14.0, y + 50.0, item.digest[:12],
    )  # fmt: skip
    current = Markup(' aria-current="page"') if here else ""
    return Markup('<a class="{}" href="{}{}"{}>{}</a>').format(classes, up, item.href, current, body)
