"""A quick likeness of a simulator's axis: the plant's own command stage, fitted to what the simulator returns.

A search tries many starts and many effects: thousands of runs. Where the likeness cannot be told from the simulator within the
noise of the sensor, on recorded commands and on altered ones, the search runs on it, at microseconds a run; what was found is
fitted once more, judged and proven on the simulator itself. A likeness that is only close gives a fit its start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Candidate, candidates_at
from sysid.gap.data import Data
from sysid.gap.feed import fed
from sysid.gap.fit import fit_candidates, place, spread_of
from sysid.gap.problem import SHORT_RUN, Problem, drive_problem
from sysid.gap.starts import starting_values
from sysid.machine import Axis
from sysid.plant import Model, Plant, axis_run, layout
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.model import SETTLE_WINDOW, frozen, in_parallel

Array = npt.NDArray[np.float64]

#: What a likeness is made of, and how commands are altered to see whether it still is one.
ALTERED = {
    "input_delay": 0.05,
    "valve_deadband": 0.04,
    "gain_curve": 1.2,
    "flow_saturation": 0.8,
    "command_rate_limit": 6.0,
    "first_order_lag": 0.05,
    "gain_error": 0.8,
    "asymmetric_gain": 0.9,
}
#: A likeness is close where it leaves less than this share of the motion within a short run.
CLOSE = 0.1
#: It is faithful where it leaves less than this multiple of the sensor's noise of a whole recording.
FAITHFUL = 0.3


@dataclass(frozen=True)
class Likeness:
    """A likeness of an axis.

    Args:
        problem: the command stage with the likeness in the place of the simulator.
        error: RMS of what it leaves of whole recordings, in noises of the sensor; the worse of recorded and altered commands.
    """

    problem: Problem
    error: float

    @property
    def faithful(self) -> bool:
        return self.error < FAITHFUL


def likeness_of(problem: Problem, plant: Plant, model: Model, runs: Sequence[Recording], sigma: float) -> Likeness | None:
    """A likeness of the axis; None where none is close.

    Args:
        problem: the command stage of an axis, predicted by the simulator.
        plant: the effects around the simulator; ``model`` without them.
        runs: recordings with what the simulator made of their commands in the place of what was measured.
        sigma: noise of the driven signal [its unit].
    """
    axis = model.machine.axis(problem.target)
    if not runs:
        return None
    parts = [c for c in candidates_at(plant, model.theta, "command", (axis.name,)) if c.effect.name in ALTERED]
    parts = [c for c in parts if c.form is c.effect.forms[0]]
    data = Data(replace(drive_problem(model, axis), nuisances=()), runs, np.array([sigma]))
    like = fit_candidates(data, model.theta, parts, starting_values(parts, (), 0)).theta
    short = replace(problem, predict=_predict(model, axis, like, SHORT_RUN), short=None)
    left = sigma * spread_of(data.residuals(like[None], data.problem.short))
    if not left < CLOSE * float(np.sqrt(np.nanmean(np.concatenate([_within(r, axis.driven) for r in runs]) ** 2))):
        return None
    whole = replace(problem, predict=_predict(model, axis, like), short=short)
    altered = _altered(parts, model.theta)
    differences = [whole.predict(altered, r) - problem.predict(altered, r) for r in runs]
    return Likeness(whole, max(spread_of(data.residuals(like[None])), spread_of(differences) / sigma))


def _altered(parts: Sequence[Candidate], theta: Array) -> Array:
    """``theta`` with effects in front, (1, N): those that a likeness is made of, all at once."""
    unknowns = [u for c in parts for u in c.unknowns]
    return place(theta, unknowns, np.array([[ALTERED[c.effect.name] for c in parts for _ in c.unknowns]]))


def _within(recording: Recording, signal: str) -> Array:
    """Motion within short runs: each from its own mean, (n,)."""
    values, length = recording.values(signal), max(2, round(SHORT_RUN * recording.rate_hz))
    parts = [values[k : k + length] for k in range(0, len(values), length)]
    return np.concatenate([part - np.mean(part) for part in parts])


def _predict(model: Model, axis: Axis, like: Array, restart_every: float | None = None) -> Callable[[Array, Recording], Array]:
    """Effects in front, the likeness, and effects behind: (lanes, N) → (lanes, n, 1). It starts as the simulator's runs do."""
    i = model.axis_index(axis.name)
    behind = [i * AXIS_WIDTH + at for at in (AT.backlash_drive, AT.joint_compliance_drive)]

    def predict(thetas: Array, recording: Recording) -> Array:
        dt, count = 1.0 / recording.rate_hz, len(recording)
        stretches = model.held(recording, axis.name)[1]
        commands = fed(model, thetas, recording, (axis.name,), stretches)[axis.name]
        length = max(2, round(restart_every / dt)) if restart_every is not None else count
        pieces = [(k, min(k + length, last)) for first, last in stretches for k in range(first, last, length)]
        segments, size = np.array(pieces, dtype=np.int64).reshape(-1, 2), layout.axis_memory(dt)
        measured, load = frozen(recording.values(axis.driven)), model.load(thetas, recording)[i]
        lanes = np.repeat(like[None], len(thetas), axis=0)
        lanes[:, behind] = thetas[:, behind]
        (position, out), share = np.full((2, len(thetas), count), np.nan), frozen(np.ones(count))

        def lane(k: int) -> None:
            axis_run.drive_axis(
                lanes[k], model.rig, i, commands[k], measured, load, share, segments, dt, model.window(recording),
                round(SETTLE_WINDOW / dt), size, True, position[k], out[k], None,
            )  # fmt: skip

        in_parallel(lane, len(thetas), count)
        return out[:, :, None]

    return predict
