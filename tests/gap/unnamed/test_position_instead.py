"""A smooth function of the position takes the names of a drive whose error it explains, and those only."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.legendre import legvander
from unnamed_data import BASE, MACHINE, Rate, disturbed_dataset

from sysid.gap import find_gap
from sysid.gap.reasons import Reason
from sysid.gap.unnamed.instead import DEGREE, PositionResidual, left_out, replaces

LOW, HIGH = MACHINE.axis("boom").stroke or (0.0, 1.0)


def uneven(v: float, x: float, load: float, t: float, dice: float) -> float:
    """A gear whose ratio is right at one end of the stroke and 8 % less at the other."""
    return -0.08 * v * (x - LOW) / (HIGH - LOW)


def slower(v: float, x: float, load: float, t: float, dice: float) -> float:
    return -0.08 * v


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "named"),
    [pytest.param(uneven, False, id="an uneven gear"), pytest.param(slower, True, id="a gain error")],
)
def test_a_gear_that_is_uneven_over_the_stroke_is_no_gain_error(rate: Rate, named: bool) -> None:
    found = find_gap(disturbed_dataset(rate), BASE)
    assert [(e.name, e.target) for e in found.effects] == [("gain_error", "boom")] * named
    if not named:
        (miss,) = (m for m in found.near_misses if (m.name, m.target) == ("gain_error", "boom"))
        assert miss.lacks is Reason.POSITION
        assert {u.target for u in found.unnamed} == {"boom"}


def recordings(error: list[float], seed: int = 0) -> list[PositionResidual]:
    """Residuals of 2000 rows that are a polynomial of the position with these coefficients, and noise of one floor."""
    rng = np.random.default_rng(seed)
    found = []
    for start in (-0.8, 0.1, 0.5):
        position = start + 0.5 * np.sin(np.linspace(0.0, 20.0, 2000))
        columns = legvander(position, DEGREE)
        found.append(PositionResidual(columns[:, : len(error)] @ np.array(error) + rng.normal(size=2000), columns))
    return found


@pytest.mark.parametrize(
    ("without", "names", "expected"),
    [
        pytest.param([0.0, 10.0, 5.0], [0.0, 0.0, 5.0], True, id="a curve that the name follows in the mean"),
        pytest.param([0.0, 10.0], [0.0], False, id="a scale alone"),
        pytest.param([0.0], [0.0], False, id="no error"),
    ],
)
def test_it_has_to_explain_a_fifth_more_and_the_name_little_beside_it(
    without: list[float], names: list[float], expected: bool
) -> None:
    assert replaces(recordings(without), recordings(names)) == expected


def test_each_recording_is_predicted_by_the_others() -> None:
    """A function of one recording alone explains nothing of the others."""
    apart = recordings([0.0])
    shifted = [PositionResidual(each.residual + size, each.columns) for each, size in zip(apart, (-30, 0, 30), strict=True)]
    assert left_out(apart) == pytest.approx(1.0, abs=0.05)
    assert left_out(shifted) > 20.0


def test_a_single_recording_replaces_nothing() -> None:
    assert not replaces(recordings([0.0, 10.0, 5.0])[:1], recordings([0.0, 0.0, 5.0])[:1])
