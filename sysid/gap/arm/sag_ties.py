"""Ties between the sensor of a position axis and its sag, where its gravity load is not known, or varies as the error does.

Over a small range a gravity moment is proportional to the angle, as is an error of the sensor's scale; where it hardly varies
it is constant, as is a bias. The errors that a stage has found are fitted by a compliance times the load. What this leaves is
compared with the change that has no practical significance beside the remaining error (the region of practical equivalence).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.effects import joint_compliance, sensor_bias
from sysid.gap.arm.sag import AT_REST, OF_SENSOR, StaticError, load_known, static_error
from sysid.gap.comparison import equivalent_change
from sysid.gap.fit import place
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.reasons import Reason
from sysid.gap.thresholds import STANDARD_ERRORS
from sysid.plant import compile_plant, gravity_load

Tie = tuple[tuple[str, str], ...]


def without_sensor_names(case: Case, stage: Stage) -> Stage:
    """A stage without names for errors of the sensor that may be sag under the load; their values stay in the plant."""
    result = stage.found
    named = [k.candidate.label for k in result.named if k.candidate.effect in OF_SENSOR and not k.ties]
    if not named or result.stage_fit is None or not _of_servo(case, stage):
        return stage
    if not _load_unknown(case, stage) and not sag_replaces(case, stage):
        return stage
    return replace(stage, result=result.without_names(dict.fromkeys(named, Reason.SAG)))


def sag_tie(case: Case, stage: Stage) -> tuple[Tie, str] | None:
    """The tie of a position axis with a significant error at rest that sag may be, and a note; else None.

    Its load is not known, or is equivalent to the errors of the sensor that would have a name.
    """
    if not _of_servo(case, stage) or stage.result is None or not stage.result.fit.candidates:
        return None
    fitted = stage.result.stage_fit
    misses = fitted.decision.near_misses if fitted is not None else ()
    unknown = _load_unknown(case, stage)
    error = _static_error(case, stage) if unknown else None
    if error is None and not any(m.lacks is Reason.SAG for m in misses):
        return None
    axis = case.plant.machine.axis(stage.problem.target)
    there = [c.key[:2] for c in stage.result.fit.candidates if c.effect in OF_SENSOR]
    bias = [(sensor_bias.EFFECT.name, axis.driven)] if unknown else []
    tie = tuple(dict.fromkeys([*there, *bias, (joint_compliance.EFFECT.name, axis.name)]))
    load = "is not known" if unknown else "varies as that error does"
    alike = f"an error of the sensor and sag under a gravity load that {load} look the same"
    if error is None:
        return tie, f"{stage.label}: {alike}"
    depends = ", which depends on the posture" if error.by_posture else ""
    return tie, f"{stage.label}: error at rest of {error.rms:.3g} (RMS of {error.holds} holds){depends}; {alike}"


def sag_replaces(case: Case, stage: Stage) -> bool:
    """Whether a sag in proportion to the load is equivalent to the sensor errors of the position axis of a searched stage."""
    machine, fit, model = case.plant.machine, stage.found.fit, compile_plant(case.plant)
    axis = machine.axis(stage.problem.target)
    i, thetas = model.axis_index(axis.name), np.stack([stage.theta, fit.theta])
    errors, loads = [], []
    for recording in stage.split.seen:
        nominal, found = model.true_signal(thetas, recording, axis.driven)
        errors.append(nominal - found)
        loads.append(gravity_load(machine, recording)[:, i])
    error, load = np.concatenate(errors), np.concatenate(loads)
    there = np.isfinite(error) & np.isfinite(load)
    error, load = error[there], load[there]
    size = float(load @ load)
    if size <= 0.0 or not error.any():
        return False
    left = error - load * float(load @ error) / size
    allowed = equivalent_change(stage.found.final_rmse) * float(stage.sigma[0])
    return float(np.sqrt(np.mean(left**2))) <= allowed


def _of_servo(case: Case, stage: Stage) -> bool:
    """Whether it is the stage of a position axis of a plant."""
    return case.adapter is None and stage.problem.kind.sags


def _load_unknown(case: Case, stage: Stage) -> bool:
    """Whether the gravity load of a position axis is not known."""
    return not load_known(case.plant.machine, stage.problem.target, stage.split.seen)


def _static_error(case: Case, stage: Stage) -> StaticError | None:
    """The error at rest beside the other effects of the stage."""
    fit = stage.found.fit
    absent = [unknown for candidate in fit.candidates if candidate.effect in AT_REST for unknown in candidate.unknowns]
    theta = place(fit.theta, absent, np.array([[unknown.nominal for unknown in absent]]))[0]
    least = float(stage.sigma[0]) * max(STANDARD_ERRORS, equivalent_change(stage.found.final_rmse))
    return static_error(stage.problem, case.plant.machine, theta, stage.split.seen, least)
