"""Named effects over several runs on one machine: which are repeatable, and whether their values agree."""

from __future__ import annotations

import dataclasses

import pytest

from repeatability import repeatability
from sysid.gap.result import Excitation, Gap, GapResult, NamedEffect

NOTHING = GapResult(
    "arm@1", "arm@1", "", "no_gap", (), (), (), (), Gap({}, {}, {}), Gap({}, {}, {}), (), ("last",), 1.0
)  # fmt: skip


def run(*effects: tuple[str, dict[str, float]], excited: tuple[str, ...] = ()) -> GapResult:
    """An answer that names ``effects`` on the boom; others of which the recordings show enough are ``excited``."""
    named = tuple(NamedEffect(name, "boom", parameters, {}, 0.5) for name, parameters in effects)
    shown = tuple(Excitation(name, "boom", True, 20, 10) for name in excited)
    return dataclasses.replace(NOTHING, effects=named, excitation=shown)


def test_what_repeats_with_the_same_value_is_consistent() -> None:
    runs = {"a": run(("backlash", {"width": 0.019})), "b": run(("backlash", {"width": 0.021})), "c": run()}
    (play,) = repeatability(runs)
    assert (play.shown, play.named, play.verdict) == (("a", "b"), ("a", "b"), "consistent")
    assert play.median("width") == pytest.approx(0.020)
    assert play.spread("width") == pytest.approx(0.05)


def test_a_run_that_shows_an_effect_and_does_not_name_it_counts_against_it() -> None:
    (play,) = repeatability({"a": run(("backlash", {"width": 0.02})), "b": run(excited=("backlash",))})
    assert (play.shown, play.named, play.verdict) == (("a", "b"), ("a",), "sometimes")
    (once,) = repeatability({"a": run(("backlash", {"width": 0.02})), "b": run()})
    assert once.verdict == "sometimes"  # one run alone repeats nothing


def test_a_run_in_which_the_effect_is_not_identifiable_does_not_count() -> None:
    named = {run_name: run(("backlash", {"width": 0.02})) for run_name in ("a", "b")}
    tied = dataclasses.replace(run(excited=("backlash",)), ambiguous=((("backlash", "boom"), ("input_delay", "boom")),))
    (play,) = repeatability({**named, "c": tied})
    assert (play.shown, play.named, play.verdict) == (("a", "b"), ("a", "b"), "consistent")


def test_one_parameter_that_moves_is_enough_to_say_so() -> None:
    runs = {
        "a": run(("valve_deadband", {"positive": 0.05, "negative": 0.02})),
        "b": run(("valve_deadband", {"positive": 0.051, "negative": 0.06})),
    }
    (band,) = repeatability(runs)
    assert band.verdict == "moves"
    assert band.to_json()["over_runs"] == {
        "positive": {"median": pytest.approx(0.0505), "spread": pytest.approx(0.0099, abs=1e-4)},
        "negative": {"median": pytest.approx(0.04), "spread": pytest.approx(0.5)},
    }


def test_vectors_are_compared_component_by_component() -> None:
    effect = NamedEffect("base_misalignment", "base", {"translation": (0.1, 0.0, 0.0)}, {}, 0.5)
    answer = dataclasses.replace(NOTHING, effects=(effect,))
    (moved,) = repeatability({"a": answer, "b": answer})
    assert dict(moved.parameters) == {"translation[0]": (0.1, 0.1), "translation[1]": (0.0, 0.0), "translation[2]": (0.0, 0.0)}
    assert moved.verdict == "consistent"
