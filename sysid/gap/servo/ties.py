"""Ties between the sensor of a position axis and its sag, where its gravity load is not known, or varies as the error does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.effects import joint_compliance, sensor_bias, sensor_scale
from sysid.gap.candidates import Candidate
from sysid.gap.equivalence import equivalent_change
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.servo.alike import sag_replaces
from sysid.gap.servo.load import load_known
from sysid.gap.servo.static_error import StaticError, static_error
from sysid.gap.thresholds import STANDARD_ERRORS

Array = npt.NDArray[np.float64]
Tie = tuple[tuple[str, str], ...]
#: What the note of a tie states of the load.
UNKNOWN, ALIKE = "is not known", "varies as that error does"

#: Effects of the sensor that look like the sag of an unknown load: constant, or in proportion to the angle.
OF_SENSOR = (sensor_bias.EFFECT.name, sensor_scale.EFFECT.name)
#: Condition for a name that such an effect fails.
LOAD_UNKNOWN = "the gravity load of the axis is not known, and sag under a load looks the same"
#: The same where the load is known.
LOAD_ALIKE = "sag in proportion to the gravity load of the axis looks the same, within what remains unexplained"


def without_sensor_names(case: Case, stage: Stage) -> Stage:
    """A stage without names for errors of the sensor that may be sag under the load; their values stay in the plant."""
    result, fitted = stage.found, stage.found.stage_fit
    named = [k.candidate.label for k in result.named if _of_sensor(k.candidate) and not k.ties]
    if not named or fitted is None or not _of_servo(case, stage):
        return stage
    unknown = _load_unknown(case, stage)
    if not unknown and not sag_replaces(case, stage):
        return stage
    lost = dict.fromkeys(named, LOAD_UNKNOWN if unknown else LOAD_ALIKE)
    return replace(stage, result=result.without_names(lost))


def sag_tie(case: Case, stage: Stage) -> tuple[Tie, str] | None:
    """The tie of a position axis with a significant error at rest that sag may be, and a note; else None.

    Its load is not known, or is equivalent to the errors of the sensor that would have a name.
    """
    if not _of_servo(case, stage) or stage.result is None or not stage.result.fit.candidates:
        return None
    there = [c for c in stage.result.fit.candidates if _of_sensor(c)]
    fitted = stage.result.stage_fit
    misses = fitted.decision.near_misses if fitted is not None else ()
    named = any(m.lacks in (LOAD_UNKNOWN, LOAD_ALIKE) for m in misses)
    unknown = _load_unknown(case, stage)
    error = _static_error(case, stage) if unknown else None
    if error is None and not named:
        return None
    axis = case.plant.machine.axis(stage.problem.target)
    bias = [(OF_SENSOR[0], axis.driven)] if unknown else []
    tie = dict.fromkeys([*(c.key[:2] for c in there), *bias, (joint_compliance.EFFECT.name, axis.name)])
    return tuple(tie), f"{stage.label}: {_text(error, unknown)}"


def _text(error: StaticError | None, unknown: bool) -> str:
    alike = f"an error of the sensor and sag under a gravity load that {UNKNOWN if unknown else ALIKE} look the same"
    if error is None:
        return alike
    depends = ", which depends on the posture" if error.by_posture else ""
    return f"error at rest of {error.rms:.3g} (RMS of {error.holds} holds){depends}; {alike}"


def _of_sensor(candidate: Candidate) -> bool:
    return candidate.effect.name in OF_SENSOR


def _of_servo(case: Case, stage: Stage) -> bool:
    """Whether it is the stage of a position axis of a plant."""
    problem = stage.problem
    if case.adapter is not None or problem.stage != "command":
        return False
    return case.plant.machine.axis(problem.target).actuation == "position"


def _load_unknown(case: Case, stage: Stage) -> bool:
    """Whether the gravity load of a position axis is not known."""
    return not load_known(case.plant.machine, stage.problem.target, stage.split.seen)


def _static_error(case: Case, stage: Stage) -> StaticError | None:
    """The error at rest beside the other effects of the stage."""
    theta = stage.found.fit.theta.copy()
    for candidate in stage.found.fit.candidates:
        if _of_sensor(candidate) or candidate.effect.name == joint_compliance.EFFECT.name:
            for unknown in candidate.unknowns:
                theta[list(unknown.places)] = unknown.nominal
    least = float(stage.sigma[0]) * max(STANDARD_ERRORS, equivalent_change(stage.found.final_rmse))
    return static_error(stage.problem, case.plant.machine, theta, stage.split.seen, least)
