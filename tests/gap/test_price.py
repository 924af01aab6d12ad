"""What effects have to reduce, on recordings some of which they cannot move."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.gap.comparison import left_where_acting, pays

ROWS = 1000.0
SIZES = st.lists(st.floats(1.0, 100.0), min_size=1, max_size=6)


def left(before: list[float], after: list[float], moved: list[float], averaged_out: float = 0.0) -> float:
    """Remaining error, from RMS errors of recordings of one length."""
    squares = (ROWS * np.array(each) ** 2 for each in (before, after, moved))
    return left_where_acting(*squares, np.full(len(before), ROWS), averaged_out)


@given(SIZES, SIZES)
def test_effects_that_act_everywhere_leave_the_rms_error(before: list[float], after: list[float]) -> None:
    n = min(len(before), len(after))
    plain = float(np.sqrt(np.mean(np.square(after[:n]))))
    assert left(before[:n], after[:n], [5.0] * n) == pytest.approx(plain)


@given(st.integers(0, 6))
def test_recordings_that_effects_cannot_move_do_not_change_whether_they_pay(others: int) -> None:
    """A saturation leaves 3 of 10 noise floors in the one recording with full commands; others are wrong by 4 all the same."""
    before, after, moved = ([here] + [there] * others for here, there in ((10.0, 4.0), (3.0, 4.0), (9.0, 0.0)))
    nothing = float(np.sqrt(np.mean(np.square(before))))
    assert pays(nothing, left(before, after, moved))
    assert (others == 0) == pays(nothing, float(np.sqrt(np.mean(np.square(after)))))


def test_effects_pay_on_all_recordings_if_those_they_move_contain_less_than_half_of_the_error() -> None:
    before, after = [10.0, 10.5], [2.0, 10.5]
    assert left(before, after, [9.0, 0.0]) == pytest.approx(np.sqrt(np.mean(np.square(after))))
    assert left([10.0, 9.5], [2.0, 9.5], [9.0, 0.0]) == pytest.approx(2.0, abs=0.05)


def test_a_change_within_the_region_of_equivalence_is_none() -> None:
    before, after = [10.0, 4.0], [3.0, 4.0]
    assert left(before, after, [9.0, 0.45]) == pytest.approx(left(before, after, [9.0, 0.0]))
    assert left(before, after, [9.0, 0.47]) == pytest.approx(np.sqrt(np.mean(np.square(after))))


def test_noise_that_averages_out_of_a_row_counts_as_remaining_error() -> None:
    """As the remaining error of a stage does: a row without error of the formulas has the noise that its mean keeps."""
    kept = float(np.sqrt(1.0 - 0.9))
    assert left([5.0, 5.0], [kept, kept], [5.0, 5.0], 0.9) == pytest.approx(1.0)
    assert left([5.0, kept], [kept, kept], [5.0, 0.0], 0.9) == pytest.approx(1.0)
