"""Values of the effects of an arm of servos, from the free run of all its axes together.

Each axis by itself decides which effects there are, beside the motion of the others and a discrepancy that takes a share of
what an effect explains. Where the plant with all of them explains the recordings to within noise, the values are those of least
squares of the coupled free run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Candidate
from sysid.gap.fit import place
from sysid.gap.likelihood.stage import steps_of
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.result import NamedEffect, Value
from sysid.gap.thresholds import EXPLAINED
from sysid.machine import EffectKey, KnownEffect
from sysid.plant import Model, Plant, compile_plant
from sysid.plant.plant import effect_key
from sysid.plant.rollout import run_steps, start_states
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Most steps of the least squares, and the share of the cost below which a step has converged.
STEPS, CONVERGED = 12, 1e-9


def with_coupled_values(
    case: Case, stages: Sequence[Stage], repaired: Plant, named: Sequence[NamedEffect]
) -> tuple[Plant, list[NamedEffect]]:
    """Plant and names with the values of the coupled free run; as they are where it does not explain the recordings.

    Effects that one axis adjusts beside its names, against the motion of the others, are left out where the names alone explain
    the recordings as well.
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
            best, changed, uncertainty = fewer, alone, uncertainty.without({c.key for c in changed} - {*names})
    if not best.better or not best.explains:
        return repaired, list(named)
    for candidate, instance in zip(changed, best.instances, strict=True):
        if (name := names.get(candidate.key)) is not None:
            names[candidate.key] = _moved(name, instance)
    return best.plant.with_uncertainty(uncertainty), list(names.values())


def _as_before(tested: Plant, repaired: Plant, key: EffectKey) -> Plant:
    """The repaired plant with an effect as the tested one has it."""
    known = tested.effect(*key)
    return repaired.without_effect(*key) if known is None else repaired.with_effect(known)


@dataclass(frozen=True)
class _Fitted:
    """A plant with the values of least squares of the coupled free run.

    Args:
        better: the values lower the error; ``explains``: every joint is explained to within noise.
        criterion: Bayesian information criterion for errors of the size that they have.
    """

    plant: Plant
    instances: tuple[KnownEffect, ...]
    better: bool
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
    better, instances, at = plant, list[KnownEffect](), 0
    for candidate in changed:
        instances.append(candidate.instance(found.x[at : at + len(candidate.unknowns)]))
        at += len(candidate.unknowns)
        better = better.with_effect(instances[-1])
    criterion = count * math.log(max(squares / count, 1e-12)) + len(unknowns) * math.log(count)
    return _Fitted(better, tuple(instances), squares < float(before @ before), _explains(found.fun, runs), criterion)


class _Run:
    """Errors of the coupled free run of a recording, in standard deviations of the sensors."""

    def __init__(self, case: Case, model: Model, recording: Recording) -> None:
        self._model, self._recording, self._starts = model, recording, start_states(model, recording)
        self._signals = [axis_signal(name, "joint") for name in model.machine.axis_names]
        self._noise = np.array([case.noise[signal] for signal in self._signals])
        self._measured = np.column_stack([recording.values(signal) for signal in self._signals])

    def errors(self, theta: Array) -> Array:
        """Measured less simulated joints, one after the other; zero where either is missing."""
        model, recording = replace(self._model, theta=theta), self._recording
        joints = run_steps(model, recording, self._starts, len(recording))[0][1]
        read = [
            model.sensed(theta[None], signal, np.ascontiguousarray(joint)[None], 1.0 / recording.rate_hz)[0]
            for signal, joint in zip(self._signals, joints.T, strict=True)
        ]
        return np.asarray(np.nan_to_num((self._measured - np.column_stack(read)) / self._noise).T.ravel())

    @property
    def shape(self) -> tuple[int, int]:
        return len(self._signals), len(self._recording)


def _explains(errors: Array, runs: Sequence[_Run]) -> bool:
    """Whether every joint of all runs together is explained to within noise."""
    squares, count, at = np.zeros(runs[0].shape[0]), 0, 0
    for run in runs:
        joints, rows = run.shape
        squares += (errors[at : at + joints * rows].reshape(joints, rows) ** 2).sum(axis=1)
        at, count = at + joints * rows, count + rows
    return bool(np.sqrt(squares / count).max() <= EXPLAINED)


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
