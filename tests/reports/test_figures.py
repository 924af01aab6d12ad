"""One description of each figure: its texts, and the table that every renderer gets."""

from __future__ import annotations

import math

import pytest

from sysid.figures import ErrorFigure, NetworkError, ParameterFigure, Table, stored_parameters, times
from sysid.gap.result import Gap
from sysid.registry.effect_changes import EffectChange, change_cells
from sysid.reports.pages import filled
from sysid.reports.result_figures import error_table, point_errors
from sysid.reports.words import effect_title


def plain(text: str) -> str:
    """With ordinary spaces, so that the expected texts can be typed."""
    return text.replace("\N{NARROW NO-BREAK SPACE}", " ")


def test_a_value_has_the_digits_of_its_interval_and_its_unit_in_both() -> None:
    figure = ParameterFigure("width", "rad", 0.0105102, (0.009, 0.011))
    assert (figure.text, figure.interval) == ("0.602°", "0.516 to 0.630°")
    narrow = ParameterFigure("width", "rad", 0.0105102, (0.010508, 0.010513))
    assert (narrow.text, narrow.interval) == ("0.60219°", "0.60206 to 0.60235°")
    assert plain(ParameterFigure("time_constant", "s", 0.17, (0.165, 0.175), 0.06).sentence) == (
        "time constant 170 ms (165 to 175 ms)"
    )


def test_vectors_words_and_what_is_not_known_have_texts() -> None:
    vector = ParameterFigure("translation", "m", (0.012, -0.001), ((0.011, -0.002), (0.013, 0.0)))
    assert plain(vector.text) == "(12.0 mm, −1.00 mm)"
    assert plain(vector.interval) == "11.0 to 13.0 mm, −2.00 to 0 mm"
    assert (ParameterFigure("side", "", "drive").text, ParameterFigure("width", "m", None).text) == ("drive", "none")
    for ends in (None, (math.nan, math.nan), (math.nan, 1.0)):
        assert ParameterFigure("width", "m", 0.01, ends).interval == "–"


def test_parameters_of_a_stored_effect_are_those_that_it_states() -> None:
    effect = {
        "parameters": {"width": 0.0105102, "other": None},
        "interval95": {"width": [0.009, 0.011]},
        "units": {"width": "rad"},
    }
    (figure,) = stored_parameters(effect)
    assert figure.sentence == "width 0.602° (0.516 to 0.630°)"
    (older,) = stored_parameters({"parameters": {"width": 0.0105102}})
    assert (older.text, older.interval) == ("0.0105", "–"), "an older lineage states neither unit nor interval"


def test_a_change_of_an_effect_is_told_with_its_title() -> None:
    change = EffectChange("backlash", "slew", "width", None, 0.01, (0.009, 0.011), "rad")
    assert change_cells(change, effect_title) == ("Backlash", "slew", "width", "none", "0.573°", "0.516 to 0.630°")
    assert change_cells(EffectChange("stiction", "boom", "", 0.1, None))[3:] == ("0.100", "none", "")


GAP = Gap(
    {"boom.joint": 0.1, "ee.x": 3e-3, "ee.y": 4e-3}, {"boom.joint": 0.02, "ee.x": 3e-4, "ee.y": 4e-4}, {"boom.joint": 0.01}
)
UNITS = {"boom.joint": "rad", "ee.x": "m", "ee.y": "m"}


def test_an_error_is_the_same_in_every_table() -> None:
    table = error_table(GAP, UNITS)
    assert [[plain(str(cell)) for cell in row] for row in table.rows] == [
        ["boom.joint", "5.73°", "1.15°", "0.573°", "89 %"],
        ["ee.x", "3.00 mm", "0.300 mm", "–", "–"],
        ["ee.y", "4.00 mm", "0.400 mm", "–", "–"],
    ]
    assert "| boom.joint | 5.73° | 1.15° | 0.573° |" in table.markdown()
    assert '<td class="r">5.73°</td>' in filled("table.html", table=table, look="numbers")


def test_coordinates_of_a_point_are_one_distance() -> None:
    joint, tip = point_errors(GAP, UNITS)
    assert (joint.name, tip.name, tip.unit) == ("boom joint", "tip position", "m")
    assert (tip.before, tip.after) == pytest.approx((5e-3, 5e-4))


def test_what_is_within_the_noise_floor_has_no_closed_share() -> None:
    assert math.isnan(ErrorFigure("a", "m", 1.04, 1.0, 1.0).closed)
    assert ErrorFigure("a", "m", 2.0, 1.5, 1.0).closed == 0.5
    assert (plain(times(3.0, 1.0)), times(3.0, 0.0)) == ("3.0 ×", "–")


def test_the_best_simple_model_has_the_smallest_error() -> None:
    error = NetworkError("boom.joint", "motion", "rad", 0.01, 0.02, 0.03, None, {"linear": 0.02, "linkage": 0.005})
    assert (error.best_simple, error.texts) == ("linkage", ("0.573°", "1.15°", "1.72°"))
    assert NetworkError("boom.joint", "motion", "rad").best_simple == ""


def test_cells_are_escaped() -> None:
    table = Table(("a",), [("<b>|</b>",)])
    assert "<b>" not in filled("table.html", table=table, look="")
    assert r"\|" in table.markdown()
