"""Paths of an end effector: helix and circle, and paths in a CSV file.

The paper does not state its helix. The default here: radius 0.20 m, 10 s a turn, 0.02 m climb a turn, 3 turns, about a vertical
axis at which the joints keep farthest from their limits (:func:`centre_for`).
"""

from __future__ import annotations

import csv
import itertools
import math
from dataclasses import dataclass
from pathlib import Path as File

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError
from sysid.machine import Machine
from sysid_rl.train.inverse_kinematics import InverseKinematics

Array = npt.NDArray[np.float64]

RADIUS, TURN_S, CLIMB, TURNS = 0.20, 10.0, 0.02, 3
#: Columns of a CSV file: seconds and metres.
COLUMNS = ("t", "x", "y", "z")
#: A point counts as reached within this distance [m].
REACHED = 1e-3
#: Grid of the candidates for the centre of a path [m].
GRID = 0.05
#: Points of a path at which a centre is evaluated, and searches for the first of them.
_SAMPLES, _TRIES = 13, 48


@dataclass(frozen=True)
class Path:
    """Targets at equal time steps.

    Args:
        name: for people.
        rate_hz: points a second.
        points: (n, 3) [m] in the base frame; the first one is the start.
    """

    name: str
    rate_hz: float
    points: Array

    @property
    def time(self) -> Array:
        """(n,) [s]."""
        return np.arange(len(self.points)) / self.rate_hz

    @property
    def speed(self) -> float:
        """Greatest speed [m/s]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).max()) * self.rate_hz

    def at(self, steps: int | Array) -> Array:
        """The points ``steps`` after the beginning; the last point beyond the end."""
        return self.points[np.minimum(steps, len(self.points) - 1)]


def helix(
    centre: npt.ArrayLike,
    rate_hz: float = 100.0,
    *,
    radius: float = RADIUS,
    turn_s: float = TURN_S,
    climb: float = CLIMB,
    turns: float = TURNS,
    name: str = "helix",
) -> Path:
    """A helix about the vertical through ``centre`` (3,), which is the middle of its axis; begins at +x.

    ``x = cx + r·cos φ, y = cy + r·sin φ, z = cz + climb·(φ/2π − turns/2)``, φ from 0 to 2π·turns.
    """
    count = round(turns * turn_s * rate_hz) + 1
    share = np.arange(count) / (turn_s * rate_hz)  # turns so far
    x, y, z = np.asarray(centre, dtype=np.float64)
    angle = 2.0 * math.pi * share
    points = np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z + climb * (share - 0.5 * turns)])
    return Path(name, rate_hz, points)


def circle(centre: npt.ArrayLike, rate_hz: float = 100.0) -> Path:
    """One level turn about ``centre`` (3,)."""
    return helix(centre, rate_hz, climb=0.0, turns=1.0, name="circle")


def eased(path: Path, ease_s: float) -> Array:
    """The points of ``path`` (n, 3) with speed ramps of ``ease_s`` at both ends, where the machine is at rest."""
    ease = round(ease_s * path.rate_hz)
    last = len(path.points) - 1
    if ease < 1 or 2 * ease > last:
        return path.points.copy()
    up = 0.5 - 0.5 * np.cos(np.pi * (np.arange(ease) + 0.5) / ease)
    steps = np.concatenate([up, np.ones(last - ease), up[::-1]])  # steps of the path per cycle; their sum is `last`
    place = np.concatenate([[0.0], np.cumsum(steps)])
    return np.column_stack([np.interp(place, np.arange(last + 1), column) for column in path.points.T])


def centre_for(
    inverse: InverseKinematics,
    low: Array,
    high: Array,
    *,
    floor: float = -math.inf,
    radius: float = RADIUS,
    height: float = CLIMB * TURNS,
) -> Array:
    """The centre (3,) [m] of a helix along which the joints keep farthest from their bounds.

    Candidates are a grid of :data:`GRID` in the plane y = 0 of the base frame, inside the box ``low`` … ``high`` (3,) that the
    machine reaches; the whole helix stays above ``floor``.

    Raises:
        SettingsError: no candidate fits.
    """
    rng = np.random.default_rng(0)
    shape = helix(np.zeros(3), 1.0, radius=radius, turn_s=_SAMPLES - 1, climb=height, turns=1.0).points
    best, score = None, 0.0
    first, last = np.ceil(low / GRID).astype(int), np.floor(high / GRID).astype(int)
    for x, z in itertools.product(range(first[0], last[0] + 1), range(first[2], last[2] + 1)):
        centre = np.array([GRID * x, 0.0, GRID * z])
        if centre[2] - 0.5 * height < floor - 1e-9:
            continue
        begin, left = inverse.reach(centre + shape[0], rng, _TRIES)
        if left > REACHED:
            continue
        joints, distance = inverse.follow(centre + shape, begin)
        margin = float(inverse.margin(joints).min())
        if distance.max() < REACHED and margin > score:
            best, score = centre, margin
    if best is None:
        found = f"no place for a helix of radius {radius} m and height {height} m"
        raise SettingsError("path", found, "one that fits into what the machine reaches", "Give a smaller one in a file.")
    return best


def lowest_height(machine: Machine) -> float:
    """Lowest height of the tip [m] at which the hanging tool clears the foot of the machine (z = 0) by :data:`GRID`."""
    kinematics = machine.kinematics()
    if kinematics is None or machine.tool is None:
        return GRID
    by_child = {joint.child: joint for joint in kinematics.joints.values()}
    link, length = machine.tool, 0.0
    while link != machine.tip and link in by_child:
        length += float(np.linalg.norm(by_child[link].origin[:3, 3]))
        link = by_child[link].parent
    return GRID + length


def read_path(file: File, rate_hz: float) -> Path:
    """A path in a CSV file with the columns t [s], x, y, z [m], linear between its rows.

    Raises:
        InputError: no such file, other columns, a row without four finite numbers, or time that does not increase.
    """
    try:
        lines = list(csv.reader(file.read_text("utf-8").splitlines()))
    except (FileNotFoundError, IsADirectoryError):
        raise InputError(f"--path {file}", "no such file", "helix, circle or a CSV file with the columns t,x,y,z") from None
    except UnicodeDecodeError:
        raise InputError(file, "not UTF-8 text", "a CSV file with the columns t,x,y,z") from None
    header = tuple(cell.strip() for cell in lines[0]) if lines else ()
    if header != COLUMNS:
        raise InputError(f"{file}, line 1", f"columns {','.join(header) or 'none'}", "t,x,y,z in seconds and metres")
    rows = np.array([_row(file, number, line) for number, line in enumerate(lines[1:], start=2) if line])
    if len(rows) < 2:
        raise InputError(file, f"{len(rows)} points", "at least two")
    back = np.flatnonzero(np.diff(rows[:, 0]) <= 0.0)
    if len(back):
        number = int(back[0]) + 1
        raise InputError(file, f"time {rows[number, 0]:g} s follows {rows[number - 1, 0]:g} s", "increasing time")
    time = np.arange(math.floor((rows[-1, 0] - rows[0, 0]) * rate_hz + 1e-9) + 1) / rate_hz
    points = np.column_stack([np.interp(time, rows[:, 0] - rows[0, 0], column) for column in rows.T[1:]])
    return Path(file.stem, rate_hz, points)


def _row(file: File, number: int, line: list[str]) -> list[float]:
    try:
        values = [float(cell) for cell in line]
    except ValueError:
        raise InputError(f"{file}, line {number}", ",".join(line), "four numbers: t,x,y,z") from None
    if len(values) != len(COLUMNS) or not all(math.isfinite(value) for value in values):
        raise InputError(f"{file}, line {number}", ",".join(line), "four numbers: t,x,y,z")
    return values


def check_reach(path: Path, inverse: InverseKinematics) -> Array:
    """Joints (n, A) along the path, from the start that keeps farthest from the bounds.

    Raises:
        InputError: a point out of reach; the message names the first and the worst.
    """
    begin, _ = inverse.reach(path.points[0], np.random.default_rng(0))
    joints, left = inverse.follow(path.points, begin)
    for k in np.flatnonzero(left > REACHED):  # another posture may reach the point
        again, distance = inverse.reach(path.points[k], np.random.default_rng(int(k)))
        if distance > REACHED:
            worst, place = int(np.argmax(left)), ", ".join(f"{value:.3f}" for value in path.points[k])
            raise InputError(
                f"path {path.name}",
                f"at {path.time[k]:.2f} s ({place}) the machine stays {1e3 * distance:.0f} mm away, and "
                f"{1e3 * left[worst]:.0f} mm at {path.time[worst]:.2f} s",
                "points that the machine reaches",
                "Move or shrink the path.",
            )
        joints[k:], left[k:] = inverse.follow(path.points[k:], again)
    return joints
