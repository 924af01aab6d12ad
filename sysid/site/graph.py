"""The lineage of items as a layered graph: sources on the left, what was made from them on the right.

Layers and crossings as by Sugiyama, Tagawa and Toda, "Methods for visual understanding of hierarchical system structures", IEEE
Trans. Systems, Man and Cybernetics 11 (1981): each item one layer right of its last source, the order in a layer by the mean
position of its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

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
