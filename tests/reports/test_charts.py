"""Charts and room on the drawing."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.figures import ErrorFigure
from sysid.pictures import ticks
from sysid.reports.charts import ChartCurve, chart, heat_map, space_path
from sysid.reports.picture_parts import Canvas
from sysid.reports.sections.summary import dumbbells


@given(st.floats(-1e4, 1e4), st.floats(1e-6, 1e4))
def test_ticks_are_round_inside_and_neither_one_nor_many(low: float, width: float) -> None:
    found = ticks(low, low + width)
    assert 2 <= len(found) <= 8
    steps = np.diff(found)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-4)
    assert found[0] >= low - 1e-6 * width
    assert found[-1] <= low + (1.0 + 1e-6) * width


def test_a_gap_breaks_the_curve_and_nothing_leaves_the_frame() -> None:
    y = np.array([0.0, 1.0, np.nan, 3.0, 2.0])
    text = chart(np.arange(5.0), [ChartCurve(y, "before", spread=np.full(5, 0.5))], ("time [s]", "error [mm]"), noise=0.2)
    (curve,) = re.findall(r'<path class="before" d="([^"]*)"', text)
    assert curve.count("M") == 2
    points = [tuple(map(float, p)) for p in re.findall(r"([\d.]+),([\d.]+)", text)]
    assert all(0.0 <= x <= 300.0 and 0.0 <= y <= 200.0 for x, y in points)
    assert "time [s]" in text
    assert 'class="noise"' in text


@pytest.mark.parametrize("after", [0.0, 1e-6, 2e-3])
def test_errors_below_the_noise_have_a_place(after: float) -> None:
    text = dumbbells([ErrorFigure("a.joint", "rad", after, after, 1e-3)], repaired=True)
    places = [float(x) for x in re.findall(r'class="(?:before|after)" style="left:([^%]*)%', text)]
    assert len(places) == 2
    assert all(0.0 <= x <= 100.0 for x in places)


def test_a_path_in_space_changes_colour_with_the_error_and_keeps_its_gaps() -> None:
    points = np.column_stack([np.arange(6.0), np.zeros(6), np.zeros(6)])
    points[2] = np.nan
    text = space_path(points, np.array([0.0, 0.1, 1.0, 1.0, 1.0, 0.0]), 1.0, "mm")
    pieces = re.findall(r'<path d="M([^"]*)" style="stroke:color-mix\(in oklab, var\(--hot\) (\d+)%', text)[:3]
    assert [len(piece.split(" L")) for piece, _ in pieces] == [2, 3, 1], "0-1, gap, 3-4 and on to 5, 5"
    assert [share for _, share in pieces] == ["0", "100", "0"]


def test_labels_cannot_carry_markup() -> None:
    assert "<b>" not in chart(np.arange(2.0), [ChartCurve(np.zeros(2), "before")], ("<b>", "y"))


def test_a_mark_finds_the_free_side() -> None:
    canvas = Canvas(200.0, 200.0)
    canvas.line(np.array([100.0, 0.0]), np.array([100.0, 200.0]), 6.0)
    canvas.box(np.array([140.0, 100.0]), (30.0, 90.0))
    spot = canvas.place(np.array([100.0, 100.0]), (12.0, 12.0), (8.0, 16.0))
    assert spot[0] < 82.0, "left of the link: the right is taken"
    second = canvas.place(np.array([100.0, 100.0]), (12.0, 12.0), (8.0, 16.0, 24.0))
    assert np.abs(second - spot).max() >= 24.0, "the first mark has taken its place"
    assert canvas.clearance(spot, (12.0, 12.0)) < 0.0
    assert canvas.clearance(np.array([30.0, 190.0]), (12.0, 12.0)) == pytest.approx(-4.0), "beyond the edge"


def test_a_heat_map_is_darkest_at_its_largest_cell_and_blank_where_nothing_is() -> None:
    values = np.array([[1.0, 2.0], [4.0, np.nan]])
    counts = np.array([[20, 30], [2, 0]])
    edges = (np.array([0.0, 1.0, 2.0]), np.array([-1.0, 0.0, 1.0]))
    text = heat_map(values, counts, edges, ("boom joint [°]", "speed [°/s]"), "mm")
    cells = re.findall(r'<rect class="cell( few)?"[^>]*fill-opacity="([0-9.]+)"><title>([^<]*)</title>', text)
    assert [told for _, _, told in cells] == ["1.00 mm, 20 rows", "2.00 mm, 30 rows", "4.00 mm, 2 rows"]
    shades = [float(shade) for _, shade, _ in cells]
    assert shades == sorted(shades)
    assert shades[-1] == 1.0
    assert [bool(few) for few, _, _ in cells] == [False, False, True]
    assert 'aria-label="error over boom joint [°] and speed [°/s]"' in text
