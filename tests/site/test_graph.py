"""The lineage as a layered graph, and its drawing."""

from __future__ import annotations

import re

import networkx as nx
from hypothesis import given
from hypothesis import strategies as st

from sysid.site.item import Item
from sysid.site.lineage import around, drawing, layers, lineage_graph, with_waypoints

#: Numbers of up to 12 items, each made from earlier ones.
LINEAGES = st.integers(1, 12).flatmap(
    lambda count: st.tuples(*(st.sets(st.integers(0, max(0, own - 1)), max_size=3 if own else 0) for own in range(count)))
)


def items(lineage: tuple[set[int], ...]) -> list[Item]:
    return [
        Item("plant", f"m{number}@1", parents=tuple(f"plant:m{source}@1" for source in sorted(sources)))
        for number, sources in enumerate(lineage)
    ]


@given(LINEAGES)
def test_every_source_is_drawn_left_of_its_product(lineage: tuple[set[int], ...]) -> None:
    graph = lineage_graph(items(lineage))
    found = layers(graph)
    column = {key: number for number, layer in enumerate(found) for key in layer}
    assert sorted(column) == sorted(item.key for item in items(lineage))
    assert sum(map(len, found)) == len(lineage)
    assert all(column[source] < column[product] for source, product in graph.edges)


@given(LINEAGES)
def test_connections_that_others_replace_are_left_out_and_no_ancestor_is_lost(lineage: tuple[set[int], ...]) -> None:
    graph = lineage_graph(items(lineage))
    whole = nx.DiGraph([(source, item.key) for item in items(lineage) for source in item.parents])
    whole.add_nodes_from(graph)
    assert all(nx.ancestors(graph, key) == nx.ancestors(whole, key) for key in graph)
    assert graph.number_of_edges() <= whole.number_of_edges()


@given(LINEAGES)
def test_a_connection_passes_every_layer_at_a_place_of_its_own(lineage: tuple[set[int], ...]) -> None:
    graph = lineage_graph(items(lineage))
    whole, ways = with_waypoints(graph)
    found = layers(whole)
    column = {key: number for number, layer in enumerate(found) for key in layer}
    assert set(ways) == set(graph.edges)
    for (source, target), way in ways.items():
        assert (way[0], way[-1]) == (source, target)
        assert [column[key] for key in way] == list(range(column[source], column[target] + 1))
    waypoints = [key for way in ways.values() for key in way[1:-1]]
    assert len(set(waypoints)) == len(waypoints) == len(whole) - len(graph)


def test_a_long_connection_crosses_no_box() -> None:
    sample = items((set(), {0}, {1}, {2}, {0}, {3, 4}))
    text = str(drawing(lineage_graph(sample), {item.key: item for item in sample}))
    boxes = [tuple(map(float, found)) for found in re.findall(r'<rect x="(\d+)" y="(\d+)" width="182" height="58"', text)]
    assert len(boxes) == len(sample)
    levels = [tuple(map(float, found)) for found in re.findall(r" (\d+) (\d+)H(\d+)", text)]
    assert levels, "the path from 4 to 5 passes two layers"
    for begin, level, end in levels:
        assert not [box for box in boxes if box[0] < end and box[0] + 182 > begin and box[1] <= level <= box[1] + 58]


def test_only_relatives_are_around_an_item() -> None:
    graph = lineage_graph(items((set(), {0}, {0}, {1}, set())))
    assert set(around(graph, "plant:m1@1")) == {"plant:m0@1", "plant:m1@1", "plant:m3@1"}


def test_a_crossing_is_removed() -> None:
    graph = lineage_graph(items((set(), set(), {1}, {0})))
    first, second = layers(graph)
    assert [next(iter(graph.successors(key))) for key in first] == second


def test_a_circle_is_drawn_as_it_is_stated() -> None:
    both = [Item("plant", "a@1", parents=("gap:d@1",)), Item("gap", "d@1", parents=("plant:a@1",))]
    graph = lineage_graph(both)
    assert str(drawing(graph, {item.key: item for item in both})).count("<a ") == 2


def test_boxes_link_and_hold_no_markup_of_others() -> None:
    item = Item("dataset", "Kran-Größe@2", digest="ab" * 32, summary="<script>")
    text = str(drawing(lineage_graph([item]), {item.key: item}, "../", item.key))
    assert 'href="../datasets/Kran-Gr%C3%B6%C3%9Fe%402.html" aria-current="page"' in text
    assert "&lt;script&gt;" in text
    assert "<script>" not in text
