"""A stage whose output is a regression on known functions of time, so that every formula of the likelihood can be checked.

y = a·f(t) + b·g(t) + c·h(t) + noise,      θ = (a, b, c), absent at zero
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.effects import effect_named
from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.likelihood.discrepancy import Discrepancy
from sysid.gap.likelihood.disturbance import Disturbance
from sysid.gap.likelihood.rows import StageRows
from sysid.gap.likelihood.stage import StageLikelihood, Variances
from sysid.gap.problem import Problem
from sysid.gap.stage_kind import JOINT

Array = npt.NDArray[np.float64]
SIGNAL = "boom.joint"
RATE = 25.0
#: Noise of one row.
NOISE = 0.1
NAMES = ("sensor_bias", "sensor_scale", "joint_offset")


def functions(time: Array) -> Array:
    """f, g and h at some times, (n, 3): two sines and one that is nearly the first."""
    f = np.sin(1.3 * time)
    g = np.cos(0.7 * time)
    return np.column_stack([f, g, f + 0.02 * np.sin(3.1 * time)])


def candidate(k: int) -> Candidate:
    """An effect whose only parameter is the k-th of θ."""
    effect = effect_named(NAMES[k])
    unknown = Unknown(effect.forms[0].names[0], (k,), (-5.0, 5.0), 0.0, 0.01)
    return Candidate(effect, effect.forms[0], SIGNAL, None, (unknown,), ((-1.0,), (1.0,)))


def recordings(
    theta: Sequence[float],
    count: int = 4,
    seconds: float = 20.0,
    seed: int = 0,
    functions: Callable[[Array], Array] = functions,
) -> list[Recording]:
    """What is measured with ``theta`` (k,) in the machine, and these functions of time (n,) → (n, k)."""
    found = []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        time = np.arange(round(seconds * RATE)) / RATE
        y = functions(time + 31.0 * k) @ np.asarray(theta) + NOISE * rng.standard_normal(len(time))
        found.append(Recording(f"run-{k}", pd.DataFrame({"time": time, "clock": time + 31.0 * k, SIGNAL: y}), RATE))
    return found


def problem() -> Problem:
    """The stage as a fitting problem."""

    def predict(thetas: Array, recording: Recording) -> Array:
        return (functions(recording.values("clock")) @ thetas.T).T[:, :, None]

    return Problem(
        JOINT, "boom", ("boom",), (SIGNAL,), predict,
        lambda recording: recording.values(SIGNAL)[:, None], lambda recording: np.arange(len(recording)), lambda *_: problem(),
    )  # fmt: skip


def rows_of(theta: Sequence[float], **kwargs: float) -> StageRows:
    """Rows of such recordings, questioned with θ = 0."""
    return StageRows(problem(), recordings(theta, **kwargs), np.zeros(3), np.array([NOISE]))  # type: ignore[arg-type]


def discrepancy(rows: StageRows, columns: Array | None = None) -> Discrepancy:
    """One group of smooth columns; none of timing."""
    if columns is None:
        time = np.concatenate([s.time + 20.0 * s.recording for s in rows.series])
        columns = np.column_stack([np.sin(w * time) for w in (0.31, 0.47)])
    return Discrepancy(columns, np.zeros(columns.shape[1], dtype=np.int64), ("smooth",), np.zeros(rows.count))


def likelihood(
    rows: StageRows, tau: float = 0.1, disturbance: float = 1e-9, memory: float = 0.5, columns: Array | None = None
) -> StageLikelihood:
    """The likelihood of the stage with known variances."""
    variances = Variances((Disturbance(NOISE, disturbance, 0.0, memory),), np.array([tau]), np.ones(rows.count))
    return StageLikelihood(rows, discrepancy(rows, columns), variances, [np.zeros(len(s.step)) for s in rows.series])
