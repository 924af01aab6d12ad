"""Programs on the controller's grid, for every simulator: what a machine is asked for, and when a recording begins."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hidden.foreign.excitation import Take, path
from hidden.foreign.machines import Tables

Array = npt.NDArray[np.float64]

#: A machine that has stood still did so for this long before the recording, and stands on for a while in it [s].
STANDING, REST = 2.0, 0.5
#: Position controller of a force axis: as a share of the inertia, stiffness [1/s²] and damping [1/s].
FOLLOWS, DAMPS = 300.0, 25.0
#: The path that a force axis follows is rounded over this long, so that its force does not jump [s].
SMOOTH = 0.3


def counts(tables: Tables, take: Take) -> tuple[int, int, int]:
    """Cycles of the controller in all, those before the recording, and steps of the simulator in a cycle."""
    before = round((take.lead or STANDING) * tables["rate"])
    return before + round(take.seconds * tables["rate"]), before, round(1.0 / (tables["rate"] * tables["step"]))


def arm_paths(tables: Tables, take: Take, ticks: int, before: int) -> Array:
    """Set positions (ticks, axes); a machine that has stood still holds its first one before."""
    time = np.arange(ticks) / tables["rate"]
    if take.lead == 0.0:
        time = np.maximum(time - before / tables["rate"] - REST, 0.0)
    axes = tables["axes"].values()
    paths = [path(take.program, take.seed + 1000 * k, time, tuple(axis["limits"])) for k, axis in enumerate(axes)]
    return np.column_stack(paths)


def force_path(tables: Tables, take: Take, ticks: int, before: int) -> tuple[Array, Array]:
    """What the controller of a force axis follows, (ticks,), and its speed."""
    cycle = 1.0 / tables["rate"]
    time = np.arange(ticks) * cycle
    if take.lead == 0.0:
        time = np.maximum(time - before * cycle - REST, 0.0)
    window = np.hanning(round(SMOOTH * tables["rate"]))
    around = np.pad(path(take.program, take.seed, time, tuple(tables["limits"])), len(window), mode="edge")
    wanted = np.convolve(around, window / window.sum(), mode="same")[len(window) : -len(window)]
    return wanted, np.gradient(wanted, cycle)


def tracking_force(tables: Tables, wanted: float, speed: float, position: float, velocity: float) -> float:
    """Force or torque of the axis' position controller, tuned to the inertia that its owner knows."""
    known = tables.get("tuned", tables["inertia"])
    return float(known * (FOLLOWS * (wanted - position) + DAMPS * (speed - velocity)))
