"""Numbers on the page: units, digits, signs."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.display import (
    MINUS,
    decimals_for,
    fixed,
    interval,
    minute,
    number,
    percent,
    quantity,
    ratio,
    shown_unit,
    size_text,
    with_unit,
)
from sysid.errors import SettingsError
from sysid.reports.words import effect_sentence


def plain(text: str) -> str:
    """With ordinary spaces, so that the expected texts can be typed."""
    return text.replace("\N{NARROW NO-BREAK SPACE}", " ")


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0034, "m", "3.40 mm"),
        (0.0105, "rad", "0.602°"),
        (-3.165, "N", f"{MINUS}3.17 N"),
        (0.034, "s", "34.0 ms"),
        (1.5, "s", "1.50 s"),
        (0.0808, "1", "0.0808"),
        (0.0, "m", "0 mm"),
        (math.nan, "m", "–"),
        (1234567.0, "N", "1 234 567 N"),
        (1e-9, "1", "1.00 · 10⁻⁹".replace("-", MINUS)),
    ],
)
def test_quantity(value: float, unit: str, text: str) -> None:
    assert plain(quantity(value, unit)) == text


def test_interval_names_the_unit_once() -> None:
    assert plain(interval(0.0782, 0.0836, "1")) == "0.0782 to 0.0836"
    assert plain(interval(-0.001, 0.0021, "m")) == f"{MINUS}1.00 to 2.10 mm"
    assert plain(interval(0.03, 0.04, "s")) == "30.0 to 40.0 ms"
    assert plain(interval(0.119842, 0.120131, "1")) == "0.1198 to 0.1201", "as many digits as the ends need to differ"


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.834, "83 %"), (0.9972, "99.7 %"), (1.0, "100 %"), (0.9999, "100 %"), (0.004, "0.4 %"), (math.nan, "–")],
)
def test_percent_hides_no_difference_from_all_or_nothing(share: float, text: str) -> None:
    assert plain(percent(share)) == text


def test_ratio_and_fixed() -> None:
    assert plain(ratio(33.2)) == "33 ×"
    assert plain(ratio(0.98)) == "1.0 ×"
    assert fixed(-0.0001, 2) == "0.00"
    assert plain(fixed(-12345.678, 1)) == f"{MINUS}12 345.7"
    assert decimals_for([6.64, 0.2, 0.2]) == 2
    assert decimals_for([]) == 0


@given(st.floats(min_value=1e-5, max_value=1e6), st.integers(2, 5))
def test_number_is_right_to_its_digits(value: float, digits: int) -> None:
    text = number(value, digits).replace("\N{NARROW NO-BREAK SPACE}", "")
    assert float(text) == pytest.approx(value, rel=0.5 * 10 ** (1 - digits) * 1.0001)


def test_units_that_are_shown_as_they_are() -> None:
    assert shown_unit("N·m") == (1.0, "N·m")
    assert shown_unit(None) == (1.0, "")
    for unit in ("N·m·s/rad", "rad/(N·m)", "kg·m²", "1/s", "1 / s", "ppm", "%", "°C"):
        assert shown_unit(unit) == (1.0, unit)


@pytest.mark.parametrize("unit", ["joint", "drive/s", "command/s", "signal", "N or N·m", "mm", "furlong", "m;s"])
def test_what_is_no_si_unit_raises(unit: str) -> None:
    for text in (lambda: quantity(1.0, unit), lambda: interval(0.0, 1.0, unit), lambda: with_unit("speed", unit)):
        with pytest.raises(SettingsError, match=f"unit of a figure: '{unit}'; expected an SI unit"):
            text()


def test_a_title_has_the_unit_of_what_is_shown() -> None:
    assert (with_unit("speed", "rad/s"), with_unit("command", "1"), with_unit("x", None)) == ("speed [°/s]", "command", "x")


def test_sizes_and_times() -> None:
    assert [size_text(count) for count in (12, 1.5e3, 1.5e6, 2e9)] == ["12 bytes", "1.5 kB", "1.5 MB", "2.0 GB"]
    assert minute(1764087060000) == "2025-11-25 16:11"


def test_a_gain_beside_a_dead_band_is_told_as_the_slope_that_it_is() -> None:
    alone = effect_sentence("gain_error", "stick", {"ratio": "9.21"})
    beside = effect_sentence("gain_error", "stick", {"ratio": "9.21"}, {"gain_error", "valve_deadband"})
    assert alone == "The stick moves at 9.21 times the speed that the simulation assumes."
    assert beside == "Beyond its dead-band the stick responds 9.21 times as strongly as the simulation assumes."
