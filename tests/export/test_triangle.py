"""The triangle behind a table of a linkage."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.export.mjcf_drives import triangle_of
from sysid.machine import TabulatedLinkage, tabulate
from sysid.machine.description import Linkage
from sysid.machine.linkage import TriangleLinkage


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize(("a", "b"), [(0.12, 0.4), (0.4, 0.12), (0.2, 0.21)])
def test_finds_the_triangle_of_a_table(a: float, b: float, sense: int) -> None:
    turns = np.array([0.7, 1.9])
    lengths = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(turns))
    true = Linkage("triangle", a, b, 1.2 * sense, float(lengths[0]) - 0.01, sense=sense)  # type: ignore[arg-type]
    stroke = (0.01, float(lengths[1] - lengths[0]) + 0.01)
    table = tabulate(TriangleLinkage(true), stroke)
    found = triangle_of(table)
    assert found is not None
    joints = TriangleLinkage(found).joint(table.displacements)
    assert np.abs(joints - table.joints).max() < 1e-4
    assert found.sense == sense


def test_no_triangle_for_another_curve() -> None:
    x = np.linspace(0.0, 0.2, 200)
    assert triangle_of(TabulatedLinkage(x, 3.0 * x + 0.2 * np.sin(40.0 * x))) is None
