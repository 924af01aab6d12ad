"""What is identified of a simulator from its runs: linkages (cylinder → joint), tool sway, and a surrogate of each axis.

The surrogate of an axis is the command stage of the plant, fitted to the output of the simulator. A search needs thousands of
runs: many candidate effects, each from many start values. Where the surrogate agrees with the simulator within the noise of the
sensor, on recorded commands and on commands altered by test effects, the search runs on the surrogate, at microseconds a run;
the effects found are then fitted again, compared and proven on the simulator itself. A less accurate surrogate still provides
the start of a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.effects import gripper_sway
from sysid.gap.adapters.input_output_effects import apply_input_effects
from sysid.gap.adapters.simulator import Signals
from sysid.gap.candidates import candidates_at
from sysid.gap.data import Data
from sysid.gap.fit import fit_candidates, place, spread_of, starting_values
from sysid.gap.prepare.noise import noise_levels
from sysid.gap.problem import SHORT_RUN, Problem, drive_problem, tool_problem
from sysid.machine import Axis, KnownEffect, Machine, TabulatedLinkage
from sysid.plant import Model, Plant, axis_run, compile_plant, layout
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.model import SETTLE_WINDOW, frozen, in_parallel
from sysid.plant.stretches import split
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Noise assumed for a tool position that is not measured [m].
ASSUMED_NOISE = 1e-4
#: Number of points of a tabulated linkage.
POINTS = 256
#: A surrogate is rejected where its residual over short runs exceeds this share of the motion within them.
MAX_SHORT_RUN_SHARE = 0.1
#: It is accurate where its residual over whole recordings is below this multiple of the sensor noise.
MAX_ERROR = 0.3


def identify_linkages(machine: Machine, runs: Sequence[Signals]) -> dict[str, TabulatedLinkage]:
    """Axis → map from cylinder to joint, where the simulator returns both and the map is monotonic."""
    found = {}
    for axis in machine.axes:
        joint = axis_signal(axis.name, "joint")
        pairs = [(run[axis.driven], run[joint]) for run in runs if axis.driven in run and joint in run]
        if axis.drives == "cylinder" and pairs:
            x, q = (np.concatenate(part) for part in zip(*pairs, strict=True))
            there = ~np.isnan(x) & ~np.isnan(q)
            table = _table(x[there], q[there])
            if table is not None:
                found[axis.name] = table
    return found


def identify_sway(plant: Plant, dataset: Dataset, runs: Sequence[Signals]) -> KnownEffect | None:
    """Sway of the simulator's tool below its end effector; None where it does not sway, or not as a pendulum."""
    ee, tool = point_signals("ee"), point_signals("tool")
    whole = [run for run in runs if not any(np.isnan(run.get(s, np.array([np.nan]))).any() for s in (*ee, *tool))]
    if not whole:
        return None
    model, rate = compile_plant(plant), dataset.machine.rate_hz
    recordings = [Recording(f"run-{k}", pd.DataFrame(dict(run)), rate) for k, run in enumerate(whole)]
    noise = noise_levels(dataset)
    data = Data(tool_problem(model), recordings, np.array([noise.get(s, ASSUMED_NOISE) for s in tool]))
    without = spread_of(data.residuals(model.theta[None]))
    if without < 1.0:
        return None
    found = [c for c in candidates_at(plant, model.theta, ("tool",), ("tool",)) if c.effect is gripper_sway.EFFECT]
    fit = fit_candidates(data, model.theta, found, starting_values(found, (), 0))
    return found[0].instance(fit.values_of(found[0])) if spread_of(data.residuals(fit.theta[None])) < 0.1 * without else None


def _table(x: Array, q: Array) -> TabulatedLinkage | None:
    """Means over even bins of ``x`` (m,), made monotonic; None where the cylinder hardly moved."""
    span = float(np.ptp(x)) if len(x) else 0.0
    if span <= 0.0:
        return None
    bins = np.minimum((POINTS * (x - x.min()) / span).astype(np.int64), POINTS - 1)
    count = np.bincount(bins, minlength=POINTS)
    full = count > 0
    if full.sum() < 3:
        return None
    at, of = (np.bincount(bins, values, POINTS)[full] / count[full] for values in (x, q))
    sign = 1.0 if of[-1] > of[0] else -1.0
    rising = np.maximum.accumulate(sign * of) + np.arange(len(of)) * max(float(np.ptp(of)), 1e-12) * 1e-9
    return TabulatedLinkage(at, sign * rising)


@dataclass(frozen=True)
class Surrogate:
    """Surrogate model of an axis.

    Args:
        problem: the command stage with the surrogate in place of the simulator.
        error: RMS residual over whole recordings, in units of the sensor noise; the larger of recorded and test commands.
    """

    problem: Problem
    error: float

    @property
    def accurate(self) -> bool:
        return self.error < MAX_ERROR


def fit_surrogate(problem: Problem, plant: Plant, model: Model, runs: Sequence[Recording], sigma: float) -> Surrogate | None:
    """The surrogate of an axis; None where the best fit is too inaccurate.

    Args:
        problem: the command stage of an axis, predicted by the simulator.
        plant: input and output effects of the simulator; ``model`` without them.
        runs: recordings whose measured signals are replaced by the output of the simulator.
        sigma: noise of the driven signal [its unit].
    """
    axis = model.machine.axis(problem.target)
    if not runs:
        return None
    known = candidates_at(plant, model.theta, ("command",), (axis.name,))
    candidates = [c for c in known if c.effect.surrogate_test is not None and c.form is c.effect.forms[0]]
    data = Data(drive_problem(model, axis), runs, np.array([sigma]))
    fitted = fit_candidates(data, model.theta, candidates, starting_values(candidates, (), 0)).theta
    short = replace(problem, predict=_predict(model, axis, fitted, SHORT_RUN), short=None)
    left = sigma * spread_of(data.residuals(fitted[None], data.problem.short))
    motion = np.concatenate([_short_motion(r, axis.driven) for r in runs])
    if not left < MAX_SHORT_RUN_SHARE * float(np.sqrt(np.nanmean(motion**2))):
        return None
    whole = replace(problem, predict=_predict(model, axis, fitted), short=short)
    unknowns = [u for c in candidates for u in c.unknowns]
    tested = place(model.theta, unknowns, np.array([[c.effect.surrogate_test for c in candidates for _ in c.unknowns]]))
    differences = [whole.predict(tested, r) - problem.predict(tested, r) for r in runs]
    return Surrogate(whole, max(spread_of(data.residuals(fitted[None])), spread_of(differences) / sigma))


def _short_motion(recording: Recording, signal: str) -> Array:
    """Motion within short runs: deviation from the mean of each, (n,)."""
    values, length = recording.values(signal), max(2, round(SHORT_RUN * recording.rate_hz))
    parts = [values[k : k + length] for k in range(0, len(values), length)]
    return np.concatenate([part - np.mean(part) for part in parts])


def _predict(
    model: Model, axis: Axis, fitted: Array, restart_every: float | None = None
) -> Callable[[Array, Recording], Array]:
    """Input effects, surrogate, output effects: (lanes, N) → (lanes, n, 1). It starts as the runs of the simulator do."""
    i = model.axis_index(axis.name)
    output_effects = [i * AXIS_WIDTH + at for at in (AT.backlash_drive, AT.joint_compliance_drive)]

    def predict(thetas: Array, recording: Recording) -> Array:
        dt, count = 1.0 / recording.rate_hz, len(recording)
        stretches = model.held(recording, axis.name)[1]
        commands = apply_input_effects(model, thetas, recording, (axis.name,), stretches)[axis.name]
        length = max(2, round(restart_every / dt)) if restart_every is not None else count
        segments, size = split(stretches, length), layout.axis_memory(dt)
        measured, load = frozen(recording.values(axis.driven)), model.load(thetas, recording)[i]
        lanes = np.repeat(fitted[None], len(thetas), axis=0)
        lanes[:, output_effects] = thetas[:, output_effects]
        (position, out), share = np.full((2, len(thetas), count), np.nan), frozen(np.ones(count))

        def lane(k: int) -> None:
            axis_run.drive_axis(
                lanes[k], model.arrays, i, commands[k], measured, load, share, segments, dt, model.window(recording),
                round(SETTLE_WINDOW / dt), size, True, position[k], out[k], None,
            )  # fmt: skip

        in_parallel(lane, len(thetas), count)
        return out[:, :, None]

    return predict
