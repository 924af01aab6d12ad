"""Ties between the sensor of a position axis and its sag, where the gravity load of the axis is not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.effects import joint_compliance, sensor_bias, sensor_scale
from sysid.gap.candidates import Candidate
from sysid.gap.case import Case, Stage
from sysid.gap.servo.load import load_known
from sysid.gap.servo.static_error import StaticError, static_error

Array = npt.NDArray[np.float64]
Tie = tuple[tuple[str, str], ...]

#: Effects of the sensor that look like the sag of an unknown load: constant, or in proportion to the angle.
OF_SENSOR = (sensor_bias.EFFECT.name, sensor_scale.EFFECT.name)
#: Condition for a name that such an effect fails.
LOAD_UNKNOWN = "the gravity load of the axis is not known, and sag under a load looks the same"


def without_sensor_names(case: Case, stage: Stage) -> Stage:
    """A stage without names for errors of the sensor that may be sag under an unknown load; their values stay in the plant."""
    result, fitted = stage.found, stage.found.stage_fit
    lost = {k.candidate.label: LOAD_UNKNOWN for k in result.named if _of_sensor(k.candidate) and not k.ties}
    if not lost or fitted is None or not _load_unknown(case, stage):
        return stage
    rest = tuple(kept for kept in result.named if kept.candidate.label not in lost)
    adjusted = (*result.adjusted, *(kept.candidate for kept in result.named if kept.candidate.label in lost))
    unsure = replace(fitted, decision=fitted.decision.without_names(lost))
    return replace(stage, result=replace(result, named=rest, adjusted=adjusted, stage_fit=unsure))


def sag_tie(case: Case, stage: Stage) -> tuple[Tie, str] | None:
    """The tie of a position axis whose error at rest is significant while its load is not known, and a note; else None."""
    if not _load_unknown(case, stage) or stage.result is None or not stage.result.fit.candidates:
        return None
    there = [c for c in stage.result.fit.candidates if _of_sensor(c)]
    fitted = stage.result.stage_fit
    misses = fitted.decision.near_misses if fitted is not None else ()
    named = any(m.lacks == LOAD_UNKNOWN for m in misses)
    error = _static_error(case, stage)
    if error is None and not named:
        return None
    axis = case.plant.machine.axis(stage.problem.target)
    tie = dict.fromkeys([*(c.key[:2] for c in there), (OF_SENSOR[0], axis.driven), (joint_compliance.EFFECT.name, axis.name)])
    return tuple(tie), f"{stage.label}: {_text(error)}"


def _text(error: StaticError | None) -> str:
    alike = "an error of the sensor and sag under a gravity load that is not known look the same"
    if error is None:
        return alike
    depends = ", which depends on the posture" if error.by_posture else ""
    return f"error at rest of {error.rms:.3g} (RMS of {error.holds} holds){depends}; {alike}"


def _of_sensor(candidate: Candidate) -> bool:
    return candidate.effect.name in OF_SENSOR


def _load_unknown(case: Case, stage: Stage) -> bool:
    """Whether it is the stage of a position axis of a plant whose load there is not known."""
    problem, machine = stage.problem, case.plant.machine
    if case.adapter is not None or problem.stage != "command" or machine.axis(problem.target).actuation != "position":
        return False
    return not load_known(machine, problem.target, stage.split.seen)


def _static_error(case: Case, stage: Stage) -> StaticError | None:
    """The error at rest beside the other effects of the stage."""
    theta = stage.found.fit.theta.copy()
    for candidate in stage.found.fit.candidates:
        if _of_sensor(candidate) or candidate.effect.name == joint_compliance.EFFECT.name:
            for unknown in candidate.unknowns:
                theta[list(unknown.places)] = unknown.nominal
    noise = case.noise.get(stage.problem.signals[0], 0.0)
    return static_error(stage.problem, case.plant.machine, theta, stage.split.seen, noise)
