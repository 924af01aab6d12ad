"""Whether sag under a known gravity load replaces the sensor errors of a position axis without practical significance.

Over a small range a gravity moment is proportional to the angle, as is an error of the sensor's scale; where it hardly varies
it is constant, as is a bias. The errors that a stage has found are fitted by a compliance times the load. What this leaves is
compared with the change that has no practical significance beside the remaining error (the region of practical equivalence).
"""

from __future__ import annotations

import numpy as np

from sysid.gap.equivalence import equivalent_change
from sysid.gap.prepare.case import Case, Stage
from sysid.plant import compile_plant, gravity_load


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
