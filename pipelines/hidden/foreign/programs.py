"""Setpoints on the controller's grid for both simulators, and the begin of a recording."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hidden.foreign.excitation import Take, path
from hidden.foreign.machines import Tables

Array = npt.NDArray[np.float64]

#: Rest before a recording that begins at rest, and at its beginning [s].
REST_BEFORE, REST = 2.0, 0.5
#: Position controller of a force axis: as a share of the inertia, stiffness [1/s²] and damping [1/s].
STIFFNESS, DAMPING = 300.0, 25.0
#: The path of a force axis is smoothed over this time, so that its force does not jump [s].
SMOOTH = 0.3


def counts(tables: Tables, take: Take) -> tuple[int, int, int]:
    """Cycles of the controller in all, those before the recording, and steps of the simulator in a cycle."""
    before = round((take.lead or REST_BEFORE) * tables["rate"])
    return before + round(take.seconds * tables["rate"]), before, round(1.0 / (tables["rate"] * tables["step"]))


def arm_paths(tables: Tables, take: Take, ticks: int, before: int) -> Array:
    """Setpoints (ticks, axes); a machine at rest holds the first one before the recording."""
    time = np.arange(ticks) / tables["rate"]
    if take.lead == 0.0:
        time = np.maximum(time - before / tables["rate"] - REST, 0.0)
    axes = tables["axes"].values()
    paths = [path(take.program, take.seed + 1000 * k, time, tuple(axis["limits"])) for k, axis in enumerate(axes)]
    return np.column_stack(paths)


def force_path(tables: Tables, take: Take, ticks: int, before: int) -> tuple[Array, Array]:
    """Setpoints of the controller of a force axis, (ticks,), and their speed."""
    cycle = 1.0 / tables["rate"]
    time = np.arange(ticks) * cycle
    if take.lead == 0.0:
        time = np.maximum(time - before * cycle - REST, 0.0)
    window = np.hanning(round(SMOOTH * tables["rate"]))
    around = np.pad(path(take.program, take.seed, time, tuple(tables["limits"])), len(window), mode="edge")
    wanted = np.convolve(around, window / window.sum(), mode="same")[len(window) : -len(window)]
    return wanted, np.gradient(wanted, cycle)


def tracking_force(tables: Tables, wanted: float, speed: float, position: float, velocity: float) -> float:
    """Force or torque of the position controller of an axis, tuned to the known inertia."""
    known = tables.get("tuned", tables["inertia"])
    return float(known * (STIFFNESS * (wanted - position) + DAMPING * (speed - velocity)))
