"""Identification of a simulator's linkages (cylinder → joint) and tool sway from the signals that it returns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.effects import gripper_sway
from sysid.gap.adapters.simulator import Signals
from sysid.gap.candidates import candidates_at
from sysid.gap.data import Data
from sysid.gap.fit import fit_candidates, spread_of, starting_values
from sysid.gap.prepare.noise import noise_levels
from sysid.gap.problem import tool_problem
from sysid.machine import KnownEffect, Machine, TabulatedLinkage
from sysid.plant import Plant, compile_plant
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Noise assumed for a tool position that is not measured [m].
ASSUMED_NOISE = 1e-4
#: Number of points of a tabulated linkage.
POINTS = 256


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
