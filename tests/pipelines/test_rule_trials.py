"""The trials of the decision rule replace what they name, everywhere and for a while, and count what changes."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import lift_motion
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "pipelines"))
from sysid.gap import comparison, decision, fit, steps, thresholds
from sysid.gap.free_run import LeastSquares
from sysid.gap.likelihood import stage as likelihood_stage
from sysid.gap.reasons import Reason
from sysid.plant import nominal_plant
from trials.cases import answers_of, changed, needed_conditions, reaches, verdict
from trials.memory import Memory
from trials.replaced import load_all, replaced
from trials.rules import CONDITIONS, TRIALS, Changes, constants
from trials.stored import StoredCase, stored_case


@pytest.mark.parametrize("trial", list(CONDITIONS))
def test_every_condition_names_something_that_there_is(trial: str) -> None:
    load_all()
    with replaced(CONDITIONS[trial]):
        pass


def test_a_replacement_reaches_every_module_that_has_imported_the_name_and_ends() -> None:
    before = comparison.at_bound, decision.at_bound, LeastSquares.left_where_acting, decision.LEAST
    mine = (lambda *_: True, lambda *_: 0.0)
    changes = {"comparison.at_bound": mine[0], "free_run.LeastSquares.left_where_acting": mine[1], "thresholds.LEAST": 4.5}
    with replaced(changes):
        assert comparison.at_bound is decision.at_bound is mine[0]
        assert LeastSquares.left_where_acting is mine[1]
        assert decision.LEAST == thresholds.LEAST == comparison.LEAST == 4.5
    assert (comparison.at_bound, decision.at_bound, LeastSquares.left_where_acting, decision.LEAST) == before


def test_every_number_with_a_name_is_a_trial_where_a_decision_may_read_it() -> None:
    found = constants()
    assert {"thresholds.LEAST x 1.5", "held_out.FOLDS x 1.5", "unnamed.instead.DEGREE x 1.5"} <= set(found)
    assert found["thresholds.LEAST x 1.5"] == {"thresholds.LEAST": 4.5}
    assert found["held_out.FOLDS x 1.5"] == {"held_out.FOLDS": 8}
    assert reaches(found["thresholds.LEAST x 1.5"], {"sysid.gap.comparison"})
    assert not reaches(found["held_out.FOLDS x 1.5"], {"sysid.gap.comparison"})
    assert reaches(CONDITIONS["at a bound"], set())


def test_a_name_that_there_is_not_is_no_trial() -> None:
    with pytest.raises(AttributeError), replaced({"decision.nothing_of_the_kind": None}):
        pass


def test_what_is_remembered_is_computed_once() -> None:
    calls = []

    def double(value: int) -> int:
        calls.append(value)
        return 2 * value

    memory = Memory()
    remembered = memory._of(double, lambda value: value)
    assert [remembered(k) for k in (1, 2, 1)] == [2, 4, 2]
    assert calls == [1, 2]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A searched lift with a slow valve."""
    load_all()
    data = lift_motion.dataset(deadband=0.0)
    study = steps.open_study(data, nominal_plant(data.machine))
    case = StoredCase(study, Memory(), (("first_order_lag", "boom"),))
    path = tmp_path_factory.mktemp("searches") / "lift.search"
    dataclasses.replace(case, first=case.answer({})).write(path)
    return path


def test_a_stored_case_is_decided_without_another_fit(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = stored_case(stored)
    assert [case.first[key] for key in ("named", "wrong", "missed")] == [[("first_order_lag", "boom")], [], []]

    def fits(*_: object, **__: object) -> None:
        raise AssertionError("a fit")

    monkeypatch.setattr(likelihood_stage, "fit_model", fits)
    monkeypatch.setattr(fit, "fit_candidates", fits)
    assert case.answer({}) == case.first


def test_a_stored_case_shows_what_a_changed_rule_answers(stored: Path) -> None:
    before, now = answers_of(stored)
    assert now == before
    hidden = stored_case(stored).answer({"decision._lacks": lambda *_: Reason.UNCERTAIN})
    assert (hidden["named"], hidden["missed"]) == ([], [("first_order_lag", "boom")])


def answer(*named: str, wrong: tuple[str, ...] = (), missed: tuple[str, ...] = ()) -> dict[str, Any]:
    return {"named": list(named), "ties": [], "wrong": list(wrong), "missed": list(missed)}


def test_changed_answers_are_counted_by_what_they_were() -> None:
    right, wrong, less = answer("delay"), answer("delay", "leak", wrong=("leak",)), answer(missed=("delay",))
    assert [verdict(each) for each in (right, wrong, less)] == ["exact", "wrong", "incomplete"]
    one = dict.fromkeys(TRIALS, right) | {"at a bound": wrong, "thresholds.LEAST x 1.5": less}
    other = dict.fromkeys(TRIALS, less) | {"at a bound": less}
    found = changed({"first": one, "second": other})
    assert found["at a bound"] == {
        "changed": 1,
        "moves": {"exact → wrong": 1},
        "cases": ["first"],
        "plants": {},
    }
    assert found["thresholds.LEAST x 1.5"]["moves"] == {"exact → incomplete": 1}
    assert sum(each["changed"] for each in found.values()) == 2


def test_a_plant_that_leaves_a_tenth_more_or_less_is_counted_by_stage() -> None:
    right, worse = answer("delay"), answer("delay")
    right["left"] = {"one": 1.0, "two": 4.0, "three": 4.0}
    worse["left"] = {"one": 1.09, "two": 5.0, "three": 3.0}
    trials = dict.fromkeys(TRIALS, right) | {"at a bound": worse}
    found = changed({"first": trials, "second": trials})
    assert (found["at a bound"]["changed"], found["at a bound"]["plants"]) == (0, {"more": 2, "less": 2})


def test_of_two_conditions_that_stand_for_each_other_one_is_needed() -> None:
    right, wrong = answer("delay"), answer("leak", wrong=("leak",))
    first, second, alone = "at a bound", "open clocks and dead times", "a share of the gap"

    def decided(changes: Changes) -> dict[str, Any]:
        off = [name for name in CONDITIONS if CONDITIONS[name].items() <= changes.items()]
        return wrong if alone in off or {first, second} <= {*off} else right

    answers = {name: decided(changes) for name, changes in TRIALS.items()}
    later = max(first, second, key=list(CONDITIONS).index)
    assert needed_conditions(answers, decided) == [later, alone]
    assert needed_conditions(dict.fromkeys(TRIALS, right), lambda _: right) == []
