"""The share of a search follows the number of its fits, and never falls or ends early."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from sysid.gap.stage_search import TYPICAL_FITS, FitCount


@given(st.integers(1, 500))
def test_the_share_of_a_stage_rises_with_every_fit_and_stays_below_one(fits: int) -> None:
    shares: list[float] = []
    count = FitCount(lambda share, text: shares.append(share), "command stage of boom")
    for _ in range(fits):
        count("backlash(boom)")
    assert all(a < b for a, b in pairwise(shares))
    assert 0.0 < shares[0] <= 0.9 / TYPICAL_FITS
    assert shares[-1] < 1.0


def test_half_of_the_typical_fits_is_about_half_of_the_stage() -> None:
    shares: list[tuple[float, str]] = []
    count = FitCount(lambda share, text: shares.append((share, text)), "stage")
    for _ in range(TYPICAL_FITS // 2):
        count("gain")
    assert 0.4 < shares[-1][0] < 0.6
    assert shares[-1][1] == "stage: gain"
