"""The lineage of items as a layered graph: sources on the left, what was made from them on the right.

Layers and crossings as by Sugiyama, Tagawa and Toda, "Methods for visual understanding of hierarchical system structures", IEEE
Trans. Systems, Man and Cybernetics 11 (1981): each item one layer right of its last source, the order in a layer by the mean
position of its neighbours. A connection over several layers passes each of them at a waypoint of its own and crosses no box.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import networkx as nx

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
