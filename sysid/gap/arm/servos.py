"""Servos that move one arm: each is searched beside what was found on the others, and all get their values together.

Search: an axis runs by itself beside the motion of the arm as the plant has it between the samples. Where that is wrong,
small effects are adjusted in its place. A few effects of each axis are therefore fitted to its motion first; whether they are
the right ones does not matter to the motion.

Masses: the mass of a link looks like a gain or an armature on one axis by itself. It is one value for all axes before the link:
what one of them finds, with a name or adjusted, is put into the others; those that it moves are searched again. It stays if the
arm needs no more effects with it.

Values: each axis by itself decides which effects there are, beside the motion of the others and a discrepancy that takes a
share of what an effect explains. What is adjusted beside the names has to lower the error of the free run of all axes together.
Where the plant explains the recordings to within noise, its values are those of least squares of that free run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.datasets.recording import Recording
from sysid.effects import link_mass_error
from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.fit import ROUGH, Fit, fit_candidates, place, spread_of
from sysid.gap.likelihood.stage import steps_of
from sysid.gap.prepare.case import Case, Stage, stage_candidates
from sysid.gap.problem import drive_problem
from sysid.gap.proposals import along
from sysid.gap.result import NamedEffect, Value
from sysid.gap.stage_result import StageResult
from sysid.gap.thresholds import Z, as_little, at_floor
from sysid.machine import EffectKey, KnownEffect
from sysid.plant import Model, Plant, compile_plant
from sysid.plant.plant import effect_key
from sysid.plant.rollout import run_steps, start_states
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Search of stages, and that of one without some effects.
SearchStages = Callable[[Sequence[Stage]], list[StageResult]]
Search = Callable[[Stage, frozenset[EffectKey]], Stage]
#: Most steps of the least squares, and the share of the cost below which a step has converged.
STEPS, CONVERGED = 12, 1e-9
#: Effects of a first motion at most, and candidates that are fitted for each.
MOST, TRIED = 3, 3


def beside_each_other(case: Case, stages: Sequence[Stage], search: SearchStages) -> list[Stage]:
    """The searched servos of an arm: in turn, that of the largest error first, each beside the motion of the whole arm.

    The motion is by what was found on axes that are searched, and by what was fitted to the others. Those that named effects
    alone do not explain are searched again beside all that was found, where this moves them.
    """
    found, left, fitted = list(stages), set(range(len(stages))), _fitted_motion(case, stages)
    while left:
        whole = _together(case, fitted.values())
        for k in left:
            found[k] = _beside(case, found[k], whole)
        worst = max(sorted(left), key=lambda k: _error(found[k]))
        found[worst] = replace(found[worst], result=search([found[worst]])[0])
        fitted[worst] = found[worst].found.fit.theta
        left.discard(worst)
    moved = [_beside(case, stage, _together(case, fitted.values())) for stage in found]
    unclear = [k for k, stage in enumerate(moved) if not _is_clear(stage.found) and _has_moved(found[k], stage)]
    for k, result in zip(unclear, search([moved[k] for k in unclear]) if unclear else [], strict=True):
        moved[k] = replace(moved[k], result=result)
    return [replace(s, result=replace(s.found, problem=s.problem)) for s in moved]


def _together(case: Case, thetas: Iterable[Array]) -> Array:
    """The parameters of the plant under test with all that differs from it; of two values for one, the later."""
    whole = case.theta.copy()
    for theta in thetas:
        whole = np.where(theta != case.theta, theta, whole)
    return whole


def _beside(case: Case, stage: Stage, theta: Array) -> Stage:
    """A stage whose axis runs beside the motion of the others by ``theta``."""
    better = replace(compile_plant(case.plant), theta=theta)
    return replace(stage, problem=drive_problem(better, case.plant.machine.axis(stage.problem.target)))


def _fitted_motion(case: Case, stages: Sequence[Stage]) -> dict[int, Array]:
    """Parameters with which each axis moves about as it was measured, beside the others; the largest error is fitted first."""
    fitted, left = dict[int, Array](), set(range(len(stages)))
    while left:
        whole = _together(case, fitted.values())
        beside = {k: _beside(case, stages[k], whole) for k in left}
        worst = max(sorted(left), key=lambda k: _error(beside[k]))
        fitted[worst] = _fitted_axis(case, beside[worst], whole)
        left.discard(worst)
    return fitted


def _fitted_axis(case: Case, stage: Stage, whole: Array) -> Array:
    """Parameters with which one axis moves so: by least squares of its free run, one effect after the other.

    The motion that its links make changes with each: the error is that beside the motion with the effects.
    """
    fit, left = fit_candidates(_data(stage), stage.theta, (), ()), _error(stage)
    candidates = stage_candidates(case, stage) if not at_floor(left) else []
    while len(fit.candidates) < MOST and not at_floor(left):
        data = _data(stage)
        larger = [
            fit_candidates(data, stage.theta, (*fit.candidates, c), [np.concatenate([fit.values, start])], ROUGH)
            for c, start in _promising(data, fit, candidates)
        ]
        best = min(larger, key=lambda each: spread_of(data.residuals(each.theta[None])), default=fit)
        stage = _beside(case, stage, _together(case, (whole, best.theta)))
        before, left = left, spread_of(_data(stage).residuals(best.theta[None]))
        if as_little(before, left):
            break
        fit = best
    return fit.theta


def _promising(data: Data, fit: Fit, candidates: Sequence[Candidate]) -> list[tuple[Candidate, Array]]:
    """Candidates that leave least beside a fit if the motion is linear in the share of their start values; with that start."""
    used, found = {c.key for c in fit.candidates}, list[tuple[float, Candidate, Array]]()
    here = np.nan_to_num(np.concatenate([part[0].ravel() for part in data.residuals(fit.theta[None])]))
    for candidate in (c for c in candidates if c.form is c.effect.forms[0] and c.key not in used):
        nominal, starts = np.array([u.nominal for u in candidate.unknowns]), np.array(candidate.starts)
        moved = data.residuals(place(fit.theta, candidate.unknowns, starts))
        changes = here - np.nan_to_num(np.concatenate([part.reshape(len(starts), -1) for part in moved], axis=1))
        shares, gains = along(changes @ here, (changes**2).sum(axis=1))
        best = int(np.argmax(gains))
        found.append((gains[best], candidate, nominal + shares[best] * (starts[best] - nominal)))
    return [(candidate, start) for _, candidate, start in sorted(found, key=lambda each: -each[0])[:TRIED]]


def _data(stage: Stage) -> Data:
    return Data(stage.problem, stage.split.seen, stage.sigma)


def _error(stage: Stage) -> float:
    """Error of the plant under test [noise floors]."""
    return spread_of(_data(stage).residuals(stage.theta[None]))


def _has_moved(before: Stage, after: Stage) -> bool:
    """Whether an axis with its result moves otherwise beside another motion of the arm."""
    theta = before.found.fit.theta[None]
    return _differ(before, *([stage.problem.predict(theta, r) for r in before.split.seen] for stage in (before, after)))


def _is_moved_by(stage: Stage, mass: Candidate, value: Array) -> bool:
    """Whether an axis with its result moves otherwise with another mass."""
    theta = stage.found.fit.theta
    both = np.stack([theta, place(theta, mass.unknowns, value[None])[0]])
    runs = [stage.problem.predict(both, r) for r in stage.split.seen]
    return _differ(stage, [run[:1] for run in runs], [run[1:] for run in runs])


def _differ(stage: Stage, one: Sequence[Array], other: Sequence[Array]) -> bool:
    """Whether two motions of an axis differ by what raises its error by a tenth."""
    away = [(first - second) / stage.sigma for first, second in zip(one, other, strict=True)]
    return not at_floor(math.hypot(1.0, spread_of(away)))


def _is_clear(result: StageResult) -> bool:
    """Whether named effects alone explain an axis."""
    exact = result.stage_fit is None or result.stage_fit.decision.exact
    return exact and not result.adjusted and not any(kept.ties for kept in result.named) and at_floor(result.final_rmse)


def with_link_masses(stages: Sequence[Stage], search: Search) -> tuple[Stage, ...]:
    """The stages; from the tip to the base, axes that a mass moves which another one finds are searched again with it."""
    found = list(stages)
    chain = max((stage.problem.carried for stage in stages), key=len, default=())
    for link in reversed(chain):
        _settle(found, (link_mass_error.EFFECT.name, link, None), search)
    return tuple(found)


def _settle(stages: list[Stage], key: EffectKey, search: Search) -> None:
    """Decide on one mass, and replace the stages that it changes."""
    carrying = [k for k, stage in enumerate(stages) if key[1] in stage.problem.carried]
    with_it = {k: mass for k in carrying if (mass := _mass(stages[k].found, key)) is not None}
    if not with_it:
        return
    owner = min(with_it, key=lambda k: (not _is_named(stages[k].found, key), _deviation(stages[k].found, with_it[k])))
    agreeing = {k for k, mass in with_it.items() if _agree(stages[owner].found, with_it[owner], stages[k].found, mass)}
    value = stages[owner].found.fit.values_of(with_it[owner])
    others = [k for k in carrying if k not in agreeing and _is_moved_by(stages[k], with_it[owner], value)]
    tried = {}
    for k in others:
        theta = place(stages[k].theta, with_it[owner].unknowns, value[None])[0]
        tried[k] = search(replace(stages[k], theta=theta), frozenset((key,)))
    if any(_needs(tried[k].found) > _needs(stages[k].found) for k in others):
        without = {k: search(stages[k], frozenset((key,))) for k in with_it}
        lighter, heavier = (sum(_needs(some.get(k, stages[k]).found) for k in carrying) for some in (without, tried))
        if lighter < heavier - len(agreeing) + 1:  # axes that agree on the mass need it once
            tried = without
    for k, stage in tried.items():
        stages[k] = stage


def _mass(result: StageResult, key: EffectKey) -> Candidate | None:
    """The mass of an axis that has a value for it."""
    return next((candidate for candidate in result.fit.candidates if candidate.key == key), None)


def _is_named(result: StageResult, key: EffectKey) -> bool:
    return any(kept.candidate.key == key and not kept.ties for kept in result.named)


def _deviation(result: StageResult, mass: Candidate) -> float:
    """Standard deviation of the ratio of a mass."""
    assert result.stage_fit is not None
    return float(result.stage_fit.decision.model.deviations_of(mass)[0])


def _agree(one: StageResult, mass: Candidate, other: StageResult, same: Candidate) -> bool:
    """Whether two axes determine the same mass."""
    apart = abs(float(one.fit.values_of(mass)[0] - other.fit.values_of(same)[0]))
    spread = math.hypot(_deviation(one, mass), _deviation(other, same))
    return apart <= max(2.0 * Z * spread, mass.unknowns[0].negligible)


def _needs(result: StageResult) -> int:
    """Effects of an axis, and what they leave."""
    return len(result.fit.candidates) + (not at_floor(result.final_rmse))


def with_coupled_values(
    case: Case, stages: Sequence[Stage], repaired: Plant, named: Sequence[NamedEffect]
) -> tuple[Plant, list[NamedEffect]]:
    """Plant and names with the values of the coupled free run; with their own where it does not explain the recordings.

    Effects that one axis adjusts beside its names, against the motion of the others, are left out where the names alone explain
    the recordings as well, to within noise or not.
    """
    model = compile_plant(repaired) if case.adapter is None else None
    changed = _changed(case, stages, repaired) if model is not None and model.coupled else []
    joints = {axis_signal(name, "joint") for name in case.plant.machine.axis_names}
    if model is None or not changed or not all(joints <= {*recording.signals} for recording in case.split.seen):
        return repaired, list(named)
    names, uncertainty = {(each.name, each.target, each.side): each for each in named}, repaired.uncertainty
    best = _fitted(case, repaired, changed)
    alone = [candidate for candidate in changed if candidate.key in names]
    if alone and len(alone) < len(changed):
        plant = repaired
        for candidate in changed:
            plant = plant if candidate.key in names else _as_before(case.plant, plant, candidate.key)
        fewer = _fitted(case, plant, alone)
        if fewer.criterion <= best.criterion:
            best, repaired = fewer, plant
            uncertainty = uncertainty.without({c.key for c in changed} - {*names})
    if not best.explains:
        return repaired.with_uncertainty(uncertainty), list(named)
    for instance in best.instances:
        if (name := names.get(effect_key(instance))) is not None:
            names[effect_key(instance)] = _moved(name, instance)
    return best.plant.with_uncertainty(uncertainty), list(names.values())


def _as_before(tested: Plant, repaired: Plant, key: EffectKey) -> Plant:
    """The repaired plant with an effect as the tested one has it."""
    known = tested.effect(*key)
    return repaired.without_effect(*key) if known is None else repaired.with_effect(known)


@dataclass(frozen=True)
class _Fitted:
    """A plant with the values of least squares of the coupled free run.

    Args:
        explains: they lower the error, and every joint is explained to within noise.
        criterion: Bayesian information criterion for errors of the size that they have.
    """

    plant: Plant
    instances: tuple[KnownEffect, ...]
    explains: bool
    criterion: float


def _fitted(case: Case, plant: Plant, changed: Sequence[Candidate]) -> _Fitted:
    model = compile_plant(plant)
    unknowns = tuple(unknown for candidate in changed for unknown in candidate.unknowns)
    first = np.array([model.theta[unknown.places[0]] for unknown in unknowns])
    runs = [_Run(case, model, recording) for recording in case.split.seen]

    def errors(values: Array) -> Array:
        theta = place(model.theta, unknowns, values[None])[0]
        return np.concatenate([run.errors(theta) for run in runs])

    def slopes(values: Array) -> Array:
        steps, here = steps_of(unknowns, values), errors(values)
        return np.column_stack([(errors(values + row) - here) / step for row, step in zip(np.diag(steps), steps, strict=True)])

    low, high = np.array([unknown.bounds for unknown in unknowns]).T
    scale, first = np.array([unknown.negligible for unknown in unknowns]), np.clip(first, low, high)
    before = errors(first)
    found = least_squares(errors, first, slopes, bounds=(low, high), x_scale=scale, ftol=CONVERGED, xtol=1e-12, max_nfev=STEPS)
    squares, count = float(found.fun @ found.fun), len(found.fun)
    ends = np.cumsum([len(candidate.unknowns) for candidate in changed])[:-1]
    instances = tuple(candidate.instance(values) for candidate, values in zip(changed, np.split(found.x, ends), strict=True))
    better = plant
    for instance in instances:
        better = better.with_effect(instance)
    explains = squares < float(before @ before) and _explains(found.fun, runs)
    criterion = count * math.log(max(squares / count, 1e-12)) + len(unknowns) * math.log(count)
    return _Fitted(better, instances, explains, criterion)


class _Run:
    """Errors of the coupled free run of a recording, in standard deviations of the sensors."""

    def __init__(self, case: Case, model: Model, recording: Recording) -> None:
        self._model, self._recording, self._starts = model, recording, start_states(model, recording)
        self._signals = [axis_signal(name, "joint") for name in model.machine.axis_names]
        self._noise = np.array([case.noise[signal] for signal in self._signals])
        self._measured = np.column_stack([recording.values(signal) for signal in self._signals])
        self.shape = len(self._signals), len(recording)

    def errors(self, theta: Array) -> Array:
        """Measured less simulated joints, one after the other; zero where either is missing."""
        model, recording = replace(self._model, theta=theta), self._recording
        joints = run_steps(model, recording, self._starts, len(recording))[0][1]
        read = [
            model.sensed(theta[None], signal, np.ascontiguousarray(joint)[None], 1.0 / recording.rate_hz)[0]
            for signal, joint in zip(self._signals, joints.T, strict=True)
        ]
        return np.asarray(np.nan_to_num((self._measured - np.column_stack(read)) / self._noise).T.ravel())


def _explains(errors: Array, runs: Sequence[_Run]) -> bool:
    """Whether every joint of all runs together is explained to within noise."""
    ends = np.cumsum([joints * rows for joints, rows in (run.shape for run in runs)])[:-1]
    by_joint = [part.reshape(run.shape) for part, run in zip(np.split(errors, ends), runs, strict=True)]
    return at_floor(float(np.sqrt(np.mean(np.concatenate(by_joint, axis=1) ** 2, axis=1)).max()))


def _changed(case: Case, stages: Sequence[Stage], repaired: Plant) -> list[Candidate]:
    """The effects of the repaired plant that its search gave a value, each once."""
    known = {effect_key(item): item.parameters for item in case.plant.effects}
    wanted = {
        effect_key(item): set(item.parameters) for item in repaired.effects if known.get(effect_key(item)) != item.parameters
    }
    found: dict[object, Candidate] = {}
    for stage in stages:
        for result in filter(None, (stage.found, stage.found.names_alone)):
            for candidate in result.fit.candidates:
                if wanted.get(candidate.key) == set(candidate.form.names):
                    found.setdefault(candidate.key, candidate)
    return list(found.values())


def _moved(name: NamedEffect, instance: KnownEffect) -> NamedEffect:
    """A name with other values; its intervals move with them."""
    intervals = {}
    for key, (low, high) in name.interval95.items():
        away = np.asarray(instance.parameters[key]) - np.asarray(name.parameters[key])
        ends = (np.asarray(low) + away, np.asarray(high) + away)
        intervals[key] = _value(ends[0].tolist()), _value(ends[1].tolist())
    parameters: dict[str, Value] = {key: _value(value) for key, value in instance.parameters.items()}
    return replace(name, parameters=parameters, interval95=intervals)


def _value(value: float | list[float]) -> Value:
    return tuple(value) if isinstance(value, list) else value
