"""Which model to use, from errors on the same held-out rows."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from sysid.validate.report import ALIKE, recommendation

ERRORS = st.floats(1e-6, 1.0)


def test_a_network_worse_than_the_kinematics_is_not_recommended() -> None:
    errors = {"ee.x": (9.0, {"URDF kinematics": 1.0, "mean": 50.0}), "ee.y": (81.0, {"URDF kinematics": 1.0})}
    assert recommendation(errors) == "Use the URDF kinematics: its error is 9.0 to 81 times smaller on every output."


def test_a_network_better_than_every_simple_model_is_recommended() -> None:
    errors = {"a": (1.0, {"line": 2.0, "mean": 9.0}), "b": (1.0, {"line": 3.0, "mean": 9.0})}
    assert recommendation(errors) == (
        "Use the network: its error is 2.0 to 3.0 times smaller than that of the best simple model (line) on every output."
    )


def test_equal_errors_favour_the_simple_model_and_mixed_ones_are_listed() -> None:
    assert recommendation({"a": (1.02, {"line": 1.0})}) == "The line is as accurate and simpler."
    mixed = recommendation({"a": (1.0, {"line": 2.0}), "b": (2.0, {"line": 1.0})})
    assert mixed == "The network is more accurate than the line on a, and less on b."
    assert recommendation({"a": (2.0, {"line": 1.0}), "b": (1.0, {"line": 1.0})}).endswith("2.0 times smaller on a.")


def test_without_a_common_simple_model_nothing_is_recommended() -> None:
    assert recommendation({}) == ""
    assert recommendation({"a": (1.0, {})}) == ""
    assert recommendation({"a": (1.0, {"line": 1.0}), "b": (1.0, {"mean": 1.0})}) == ""


@given(ERRORS, ERRORS)
def test_the_smaller_error_wins_beyond_what_is_alike(own: float, simple: float) -> None:
    text = recommendation({"a": (own, {"line": simple})})
    assert text.startswith("Use the line") == (own / simple > ALIKE)
    assert text.startswith("Use the network") == (own / simple < 1.0 / ALIKE)


def test_an_exact_model_is_compared_too() -> None:
    assert recommendation({"a": (0.0, {"line": 0.0})}) == "The line is as accurate and simpler."
    assert recommendation({"a": (1.0, {"line": 0.0})}).startswith("Use the line")
