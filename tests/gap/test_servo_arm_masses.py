"""Servos of one arm: searched in turn beside what was found; one mass for all of them, or each without it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from servo_arms import arm_text, commands, drafted, recording_of

from sysid.gap.arm import servos as servo_arm
from sysid.gap.arm.servos import beside_each_other, with_coupled_values, with_link_masses
from sysid.gap.candidates import Candidate, Scales, candidates_at
from sysid.gap.fit import Fit, place
from sysid.gap.prepare.case import Stage
from sysid.gap.problem import Split, drive_problem
from sysid.gap.result import EffectEvidence, NamedEffect
from sysid.gap.stage_result import AcceptedEffect, StageResult
from sysid.machine import KnownEffect
from sysid.plant import compile_plant, free_run, nominal_plant

KEY = ("link_mass_error", "j2", None)


class Arm:
    """Three axes with results that state which effects each needs, with a mass of j2 in place and without."""

    def __init__(self, folder: Any) -> None:
        self.plant = nominal_plant(drafted(folder, arm_text(3)))
        self.theta, self.model = self.plant.vector(), compile_plant(self.plant)
        names = self.plant.machine.axis_names
        found = candidates_at(self.plant, self.theta, ("command", "force"), names, Scales())
        found += candidates_at(self.plant, self.theta, ("links",), names, Scales())
        self.candidates = {(c.effect.name, c.target): c for c in reversed(found)}

    def stage(self, axis: str, *effects: tuple[str, float]) -> Stage:
        problem = drive_problem(self.model, self.plant.machine.axis(axis))
        stage = Stage(problem, Split((), (), ()), np.ones(1), self.theta)
        return Stage(problem, stage.split, stage.sigma, self.theta, self.result(stage, axis, *effects))

    def result(self, stage: Stage, axis: str, *effects: tuple[str, float]) -> StageResult:
        chosen: list[Candidate] = []
        for name, _ in effects:
            chosen.append(self.candidates[name, "j2" if name == "link_mass_error" else axis])
        values = np.array([value for _, value in effects])
        unknowns = tuple(u for c in chosen for u in c.unknowns)
        fit = Fit(tuple(chosen), unknowns, values, place(stage.theta, unknowns, values[None])[0])
        named = tuple(AcceptedEffect(c, EffectEvidence(1.0, 1.0, 0.0, 2.0)) for c in chosen)
        model = SimpleNamespace(deviations_of=lambda candidate: np.array([0.001]))
        fitted: Any = SimpleNamespace(decision=SimpleNamespace(model=model, exact=True))
        return StageResult(stage.problem, named, (), fit, 5.0, 1.0, stage_fit=fitted)


def names(stages: Sequence[Stage]) -> dict[str, list[str]]:
    return {s.problem.target: [kept.candidate.effect.name for kept in s.found.named] for s in stages}


def adjusted(stage: Stage) -> Stage:
    """The same stage without names: its effects are adjusted."""
    return replace(stage, result=replace(stage.found, named=(), adjusted=tuple(k.candidate for k in stage.found.named)))


def effects(stages: Sequence[Stage]) -> dict[str, list[str]]:
    """What each axis gives the plant, with a name or without."""
    return {s.problem.target: [candidate.effect.name for candidate in s.found.fit.candidates] for s in stages}


with_or_without_a_name = pytest.mark.parametrize("has", [lambda stage: stage, adjusted], ids=["named", "adjusted"])


@pytest.fixture
def arm(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> Arm:
    monkeypatch.setattr(servo_arm, "_is_moved_by", lambda stage, mass, value: True)
    return Arm(tmp_path)


class Turns:
    """A search that finds what is stated, and keeps what the other axes had when it was called.

    ``fitted``: the effect with which j0 moves as it was measured. ``moved``: whether what is found moves the axes otherwise.
    """

    def __init__(
        self, arm: Arm, monkeypatch: pytest.MonkeyPatch, finds: dict[str, list[tuple[str, float]]], moved: bool = True
    ) -> None:
        self.arm, self.finds = arm, finds
        self.calls: list[tuple[str, list[str]]] = []
        monkeypatch.setattr(servo_arm, "_fitted_motion", self._fitted_motion)
        monkeypatch.setattr(servo_arm, "_has_moved", lambda before, after: moved)
        monkeypatch.setattr(servo_arm, "drive_problem", self._drive_problem)
        monkeypatch.setattr(servo_arm, "_error", lambda stage: {"j0": 3.0, "j1": 1.0, "j2": 9.0}[stage.problem.target])

    def _drive_problem(self, model: Any, axis: Any) -> Any:
        return replace(drive_problem(model, axis), measured=lambda recording: model.theta)

    def _fitted_motion(self, case: Any, stages: Sequence[Stage]) -> dict[int, Any]:
        unknowns = self.arm.candidates["viscous_friction", "j0"].unknowns
        rubbing = place(case.theta, unknowns, np.ones((1, len(unknowns))))[0]
        return {k: rubbing if k == 0 else case.theta for k in range(len(stages))}

    def __call__(self, stages: Sequence[Stage]) -> list[StageResult]:
        return [self._one(stage) for stage in stages]

    def _one(self, stage: Stage) -> StageResult:
        axis, theta = stage.problem.target, stage.problem.measured(None)  # type: ignore[arg-type]
        others = [n for (n, at), c in self.arm.candidates.items() if at != axis and _changed(c, theta, self.arm.theta)]
        self.calls.append((axis, sorted(others)))
        adjusted = axis == "j2" and "armature_error" not in others  # what the others move is adjusted in their place
        result = self.arm.result(stage, axis, *self.finds.get(axis, []))
        return replace(result, adjusted=(self.arm.candidates["viscous_friction", axis],) if adjusted else ())


def _changed(candidate: Candidate, theta: Any, before: Any) -> bool:
    places = [place for unknown in candidate.unknowns for place in unknown.places]
    return not np.array_equal(theta[places], before[places])


def case_of(arm: Arm) -> Any:
    return SimpleNamespace(plant=arm.plant, theta=arm.theta)


def test_axes_are_searched_from_the_largest_error_on_beside_what_was_found(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    search = Turns(arm, monkeypatch, {"j2": [("stiffness_error", 0.8)], "j0": [("armature_error", 1.3)]})
    found = beside_each_other(case_of(arm), [arm.stage(axis) for axis in ("j0", "j1", "j2")], search)
    assert search.calls == [
        ("j2", ["viscous_friction"]),  # with which j0 moves as it was measured
        ("j0", ["stiffness_error"]),
        ("j1", ["armature_error", "stiffness_error"]),
        ("j2", ["armature_error"]),  # its effects did not explain it alone
    ]
    assert names(found) == {"j0": ["armature_error"], "j1": [], "j2": ["stiffness_error"]}
    assert not any(stage.found.adjusted for stage in found)


def test_nothing_is_searched_again_where_what_was_found_moves_nothing(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    search = Turns(arm, monkeypatch, {"j1": [("stiffness_error", 0.8)], "j2": [("armature_error", 1.3)]}, moved=False)
    found = beside_each_other(case_of(arm), [arm.stage(axis) for axis in ("j0", "j1", "j2")], search)
    assert [axis for axis, _ in search.calls] == ["j2", "j0", "j1"]
    assert [len(stage.found.adjusted) for stage in found] == [0, 0, 1]
    assert beside_each_other(case_of(arm), [], search) == []
    assert len(search.calls) == 3


@with_or_without_a_name
def test_a_mass_takes_the_place_of_what_it_caused_on_an_axis_before(arm: Arm, has: Callable[[Stage], Stage]) -> None:
    stages = [arm.stage("j0"), arm.stage("j1", ("armature_error", 1.4)), has(arm.stage("j2", ("link_mass_error", 1.3)))]

    def search(stage: Stage, refuted: frozenset[Any]) -> Stage:
        assert refuted == {KEY}
        assert stage.theta[list(arm.candidates[KEY[:2]].unknowns[0].places)] == pytest.approx(1.3)
        return Stage(stage.problem, stage.split, stage.sigma, stage.theta, arm.result(stage, stage.problem.target))

    assert effects(with_link_masses(stages, search)) == {"j0": [], "j1": [], "j2": ["link_mass_error"]}


@with_or_without_a_name
def test_a_mass_that_the_axes_before_contradict_is_searched_without(arm: Arm, has: Callable[[Stage], Stage]) -> None:
    stages = [arm.stage("j0"), arm.stage("j1"), has(arm.stage("j2", ("link_mass_error", 1.3)))]

    def search(stage: Stage, refuted: frozenset[Any]) -> Stage:
        axis, heavier = stage.problem.target, not np.array_equal(stage.theta, arm.theta)
        needs = [("armature_error", 0.8)] if heavier else [("stiffness_error", 0.8)] if axis == "j2" else []
        return Stage(stage.problem, stage.split, stage.sigma, stage.theta, arm.result(stage, axis, *needs))

    assert effects(with_link_masses(stages, search)) == {"j0": [], "j1": [], "j2": ["stiffness_error"]}


def test_axes_that_a_mass_does_not_move_are_not_searched_again(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(servo_arm, "_is_moved_by", lambda stage, mass, value: stage.problem.target != "j0")
    stages = [arm.stage("j0"), arm.stage("j1", ("armature_error", 1.4)), arm.stage("j2", ("link_mass_error", 1.3))]
    asked: list[str] = []

    def search(stage: Stage, refuted: frozenset[Any]) -> Stage:
        asked.append(stage.problem.target)
        return Stage(stage.problem, stage.split, stage.sigma, stage.theta, arm.result(stage, stage.problem.target))

    assert effects(with_link_masses(stages, search)) == {"j0": [], "j1": [], "j2": ["link_mass_error"]}
    assert asked == ["j1"]


def test_a_mass_moves_an_axis_by_what_its_noise_shows(tmp_path: Any) -> None:
    arm, dt = Arm(tmp_path), 0.01
    wanted = commands(3, 600, dt)
    run = free_run(arm.plant, recording_of(wanted, wanted, dt, arm.plant.machine))
    joints = np.column_stack([run[f"{name}.joint"] for name in arm.plant.machine.axis_names])
    seen = recording_of(wanted, joints, dt, arm.plant.machine)
    stage = replace(arm.stage("j1"), split=Split((seen,), (), ()), sigma=np.array([1e-3]))
    mass = arm.candidates[KEY[:2]]
    assert [servo_arm._is_moved_by(stage, mass, np.array([ratio])) for ratio in (1.0001, 1.5)] == [False, True]


def test_a_name_decides_on_a_mass_before_a_value_without_one(arm: Arm) -> None:
    stages = [arm.stage("j0"), adjusted(arm.stage("j1", ("link_mass_error", 1.6))), arm.stage("j2", ("link_mass_error", 1.3))]
    tried: dict[str, float] = {}

    def search(stage: Stage, refuted: frozenset[Any]) -> Stage:
        (place,) = arm.candidates[KEY[:2]].unknowns[0].places[:1]
        tried[stage.problem.target] = float(stage.theta[place])
        return Stage(stage.problem, stage.split, stage.sigma, stage.theta, arm.result(stage, stage.problem.target))

    assert effects(with_link_masses(stages, search)) == {"j0": [], "j1": [], "j2": ["link_mass_error"]}
    assert tried == {"j0": pytest.approx(1.3), "j1": pytest.approx(1.3)}


def test_axes_that_agree_on_a_mass_are_not_searched_again(arm: Arm) -> None:
    stages = [arm.stage(axis, ("link_mass_error", 1.3 + k * 1e-3)) for k, axis in enumerate(("j0", "j1", "j2"))]

    def search(stage: Stage, refuted: frozenset[Any]) -> Stage:
        raise AssertionError(stage.label)

    assert set(map(tuple, names(with_link_masses(stages, search)).values())) == {("link_mass_error",)}


@pytest.mark.parametrize("true", [1.0, 1.5], ids=["compensates", "is there"])
def test_what_the_names_do_not_need_leaves_the_plant_although_something_is_missing(arm: Arm, true: float) -> None:
    mass = KnownEffect("link_mass_error", "j2", {"ratio": 0.8})
    armature = KnownEffect("armature_error", "j1", {"ratio": 1.5})
    machine, dt = arm.plant.machine, 0.01
    wanted = commands(3, 600, dt)
    truth = arm.plant.with_effect(mass).with_effect(KnownEffect("armature_error", "j1", {"ratio": true}))
    run = free_run(truth, recording_of(wanted, wanted, dt, machine))
    joints = np.column_stack([run[f"{name}.joint"] for name in machine.axis_names])
    joints[:, 0] += 0.01 * np.sin(3.0 * np.arange(600) * dt)  # which no effect of the plant explains
    seen = (recording_of(wanted, joints, dt, machine),)
    noise = {f"{name}.joint": 1e-4 for name in machine.axis_names}
    case: Any = SimpleNamespace(plant=arm.plant, theta=arm.theta, adapter=None, noise=noise, split=SimpleNamespace(seen=seen))
    stages = [arm.stage("j1", ("armature_error", 1.5)), arm.stage("j2", ("link_mass_error", 0.8))]
    named = NamedEffect("link_mass_error", "j2", {"ratio": 0.8}, {"ratio": (0.79, 0.81)}, 1.0)
    plant, names = with_coupled_values(case, stages, arm.plant.with_effect(mass).with_effect(armature), [named])
    assert names == [named]
    assert plant.effect("link_mass_error", "j2") == mass
    assert plant.effect("armature_error", "j1") == (armature if true == 1.5 else None)
