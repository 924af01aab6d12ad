"""The compiled chain one step at a time, for many lanes at once: what environments and the PyBullet world advance.

Same step functions as :func:`sysid.plant.free_run`; only the loop over time is the caller's. After ``reset`` the state is
that of sample 0; a step with the command of sample k leads to sample k + 1. A position axis is at a sample where the
command of *that* sample wants it, so the step to sample k + 1 takes its command k + 1 (:func:`step_commands`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit

from sysid.datasets.recording import Recording
from sysid.effects import backlash, gripper_sway
from sysid.errors import SettingsError
from sysid.machine import Machine
from sysid.plant import chain, layout
from sysid.plant.model import _KINDS, _WORKERS, START_WINDOW, compile_plant, held, in_parallel, measured_point
from sysid.plant.plant import Plant
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Lanes that one core steps faster than a second core can be woken for.
_SERIAL_LANES = 512
_POSITION, _SPEED, _PLAY = chain._S_POSITION, chain._S_SPEED, chain._S_PLAY
_PLAY_DRIVE, _PLAY_STRUCTURE = layout.axis_place("backlash", "drive"), layout.axis_place("backlash", "structure")
_OFFSET = layout.axis_place("joint_offset")


@dataclass(frozen=True)
class LaneState:
    """All lanes at one sample; fresh arrays, NaN where the plant has no linkage or no URDF.

    Args:
        drive: what the commands move, cylinder [m] or joint [rad or m], (lanes, axes).
        joints: as the joint sensors would read them, (lanes, axes).
        structure: where the joints of the structure stand, behind play and offset of the sensors, (lanes, axes).
        ee, tool: in the frame they are measured in, (lanes, 3) [m].
    """

    drive: Array
    joints: Array
    structure: Array
    ee: Array
    tool: Array


class Stepper:
    """A plant as a state machine over ``lanes`` that know nothing of each other.

    Args:
        rate_hz: steps a second.
        lanes: how many run side by side.
        thetas: parameter vectors, (lanes, N), where the lanes differ (sampled plants); else all are ``plant``.

    Raises:
        SettingsError: no lane, a rate that is not positive, parameter vectors of another shape.
    """

    def __init__(self, plant: Plant, rate_hz: float, lanes: int = 1, thetas: Array | None = None) -> None:
        where = f"stepper of {plant.machine.name}"
        if lanes < 1:
            raise SettingsError(where, f"{lanes} lanes", "at least one")
        if not rate_hz > 0.0:
            raise SettingsError(where, f"rate_hz = {rate_hz}", "a positive rate [Hz]")
        self.plant, self.lanes, self.rate_hz = plant, lanes, rate_hz
        self.model = model = compile_plant(plant)
        self.axes = axes = model.axes
        self.dt = 1.0 / rate_hz
        about = plant.machine.axes
        self._kinds = np.array([_KINDS[axis.actuation] for axis in about])
        self._gains = np.array([float(a.inertia or 0.0) if a.actuation == "force" else a.gain for a in about])
        self._low, self._high = np.array([axis.range for axis in about]).T.copy()
        self._by_cylinder = np.array([axis.drives == "cylinder" for axis in about])
        points = max((len(table) for table, _, _ in model.tables.values()), default=2)
        self._tables = np.full((axes, points), np.nan)
        self._grid = np.tile([0.0, 1.0], (axes, 1))
        for name, (table, low, step) in model.tables.items():
            row = plant.machine.axis_names.index(name)
            self._tables[row], self._grid[row] = table, (low, step)
        self.thetas = _checked_thetas(model.theta, thetas, lanes, where)
        self._alike = thetas is None
        # The play between sensor and structure is stepped here, before the tip, which sees none.
        self._tip_thetas = self.thetas.copy()
        self._tip_thetas[:, np.arange(axes) * layout.AXIS_WIDTH + _PLAY_STRUCTURE] = 0.0
        self._memory = np.full((lanes, axes, chain.axis_memory(self.dt)), np.nan)
        self._plays = np.full((lanes, axes), np.nan)
        self._swing = np.full((lanes, gripper_sway.MEMORY), np.nan)
        self._out = LaneState(*(np.full((lanes, n), np.nan) for n in (axes, axes, axes, 3, 3)))
        self._ready = np.zeros(lanes, dtype=np.bool_)

    def reset(
        self,
        joints: npt.ArrayLike,
        *,
        drive: npt.ArrayLike | None = None,
        speed: npt.ArrayLike | None = None,
        commands: npt.ArrayLike | None = None,
        swing: npt.ArrayLike | None = None,
        which: npt.ArrayLike | None = None,
    ) -> LaneState:
        """Put lanes at rest and return the state of all of them.

        All arrays may have one row for all lanes, or a row a lane that is reset.

        Args:
            joints: as the sensors would read them, (axes,) or (rows, axes) [rad or m].
            drive: position of what the command moves; else in the middle of its play, through the linkage.
            speed: of force axes at the start [m/s or rad/s]; else zero.
            commands: held since long before; else zero. A position axis was commanded to where it is.
            swing: place (x, y) and speed (x, y) of the tool, (4,) or (rows, 4); else it hangs at rest.
            which: indices of the lanes to reset, or a mask; else all.

        Raises:
            SettingsError: a shape does not fit, or a joint cannot be turned into a cylinder position.
        """
        lanes = np.arange(self.lanes) if which is None else np.arange(self.lanes)[np.asarray(which)]
        rows, n = len(lanes), self.axes
        read = self._rows("joints", joints, rows, n)
        begin = self._drive_of(read) if drive is None else self._rows("drive", drive, rows, n)
        begin = np.clip(begin, self._low, self._high)
        command = self._rows("commands", 0.0 if commands is None else commands, rows, n)
        command = np.where(self._kinds == chain.POSITION, begin, command)
        start = self._rows("speed", 0.0 if speed is None else speed, rows, n)
        self._memory[lanes] = np.nan
        self._plays[lanes] = np.nan
        self._swing[lanes] = np.nan
        if swing is not None:
            self._swing[lanes, :4] = self._rows("swing", swing, rows, 4)
        for row, lane in enumerate(lanes):
            _begin_lane(
                self.thetas[lane], self._memory[lane], command[row], begin[row], start[row], read[row],
                self._kinds, self._gains, self._low, self._high, self.dt,
            )  # fmt: skip
            self._observe(int(lane), int(lane) + 1)
        self._ready[lanes] = True
        return self._state()

    def begin(self, recording: Recording, run: pd.DataFrame, row: int) -> LaneState:
        """Reset all lanes to where the free run ``run`` of ``recording`` begins a stretch at ``row``."""
        machine, rest = self.plant.machine, slice(row, None)
        forced = [axis.actuation == "force" for axis in machine.axes]
        speed = [
            start_speed(recording.values(axis.driven)[rest], self.rate_hz) if moved else 0.0
            for axis, moved in zip(machine.axes, forced, strict=True)
        ]
        joints = [run[name].iloc[row] if (name := axis_signal(axis.name, "joint")) in run else np.nan for axis in machine.axes]
        swing = None
        if "tool.x" in run:
            ee = run[list(point_signals("ee"))].to_numpy(np.float64)[rest]
            swing = swing_start(self.plant, ee, measured_point(recording, "tool")[rest], self.rate_hz)
        # The drive stands before its play, the run shows what is behind it.
        drives = [self.model.drive(self.model.theta[None], recording, name)[0][0, row] for name in machine.axis_names]
        return self.reset(
            joints,
            drive=drives,
            speed=speed,
            commands=held_commands(machine, recording)[row],
            swing=swing,
        )

    def step(self, commands: npt.ArrayLike) -> LaneState:
        """Hold ``commands``, (lanes, axes) or (axes,), for one step and return the state after it.

        Raises:
            SettingsError: the shape does not fit, or a lane was never reset.
        """
        command = self._rows("commands", commands, self.lanes, self.axes)
        if not self._ready.all():
            first = int(np.argmin(self._ready))
            raise SettingsError("stepper", f"lane {first} was never reset", "reset(joints) before the first step")

        def stretch(worker: int) -> None:
            first, last = worker * self.lanes // workers, (worker + 1) * self.lanes // workers
            _advance_lanes(
                first, last, self.thetas, self._memory, command, self._kinds, self._gains, self._low, self._high, self.dt
            )
            self._observe(first, last)

        workers = min(_WORKERS, 1 + self.lanes // _SERIAL_LANES)
        in_parallel(stretch, workers, 1 << 30)
        return self._state()

    @property
    def swing(self) -> Array:
        """Place (x, y) and speed (x, y) of the tool of each lane, (lanes, 4); NaN where it hangs on nothing."""
        return self._swing[:, :4].copy()

    def _observe(self, first: int, last: int) -> None:
        """Everything behind the drive, for lanes ``first … last``."""
        out, model = self._out, self.model
        _joint_lanes(
            first, last, self.thetas, self._memory, self._plays, self._by_cylinder, self._tables, self._grid,
            out.drive, out.joints, out.structure,
        )  # fmt: skip
        if model.chain is None:
            return
        c, base, at = model.chain, layout.base_place(self.axes), layout.tool_place(self.axes)
        _tip_lanes(
            first, last, self._tip_thetas, self.thetas, self._alike, base, at, out.structure, c.origins, c.axes, c.prismatic,
            c.order, c.end, self._swing, self.dt, out.ee, out.tool,
        )  # fmt: skip

    def _state(self) -> LaneState:
        out = self._out
        return LaneState(out.drive.copy(), out.joints.copy(), out.structure.copy(), out.ee.copy(), out.tool.copy())

    def _drive_of(self, joints: Array) -> Array:
        drive = joints.copy()
        for i, axis in enumerate(self.plant.machine.axes):
            if axis.drives != "cylinder":
                continue
            if axis.name not in self.plant.linkages:
                found = "no linkage: a joint value does not say where the cylinder is"
                raise SettingsError(f"axis {axis.name}", found, "geometry in machine.toml, a fitted network, or `drive`")
            drive[:, i] = self.plant.linkages[axis.name].displacement(joints[:, i])
        return drive

    def _rows(self, name: str, values: npt.ArrayLike, rows: int, width: int) -> Array:
        array = np.asarray(values, dtype=np.float64)
        try:
            return np.broadcast_to(array, (rows, width)).copy(order="C")  # one layout: the kernels compile once
        except ValueError:
            raise SettingsError("stepper", f"{name} of shape {array.shape}", f"({width},) or ({rows}, {width})") from None


def _checked_thetas(theta: Array, thetas: Array | None, lanes: int, where: str) -> Array:
    if thetas is None:
        return np.tile(theta, (lanes, 1))
    if np.shape(thetas) != (lanes, len(theta)):
        raise SettingsError(where, f"thetas of shape {np.shape(thetas)}", f"({lanes}, {len(theta)})")
    return np.array(thetas, dtype=np.float64)


def held_commands(machine: Machine, recording: Recording) -> Array:
    """Commands of all axes with short gaps held, (n, axes); NaN where longer ones interrupt a run."""
    columns = []
    for axis in machine.axes:
        filled, stretches = held(recording.values(axis_signal(axis.name, "command")), recording.rate_hz)
        column = np.full(len(filled), np.nan)
        for first, last in stretches:
            column[first:last] = filled[first:last]
        columns.append(column)
    return np.column_stack(columns)


def step_commands(machine: Machine, commands: Array) -> Array:
    """Commands of n samples, (n, axes) → those of the n − 1 steps between them."""
    position = np.array([axis.actuation == "position" for axis in machine.axes])
    return np.where(position, commands[1:], commands[:-1])


def start_speed(measured: Array, rate_hz: float) -> float:
    """Speed from which a free run of a force axis starts: slope of the first samples (n,)."""
    return float(_start_speed(np.ascontiguousarray(measured), min(_window(rate_hz, 3), len(measured)), 1.0 / rate_hz))


def swing_start(plant: Plant, ee: Array, tool: Array, rate_hz: float) -> Array:
    """Place and speed of the tool (4,) from which a free run starts, from boom tip (n, 3) and measured tool (n, 3)."""
    start = np.empty(4)
    last = min(_window(rate_hz, 5), int(np.argmax(np.append(np.isnan(ee[:, 0]), True))))
    at = layout.tool_place(len(plant.machine.axes))
    _swing_start(plant.vector(), at, ee[:last].copy(), tool[:last].copy(), 1.0 / rate_hz, start)
    return start


def _window(rate_hz: float, least: int) -> int:
    return max(least, round(START_WINDOW * rate_hz))


@njit(cache=True, nogil=True)
def _start_speed(measured, last, dt):
    return chain._slope(measured, 0, last, dt)


@njit(cache=True, nogil=True)
def _swing_start(p, at, pivot, measured, dt, start):
    """The same corrections as at the beginning of :func:`sysid.plant.chain.tool`."""
    s = np.empty(gripper_sway.MEMORY)
    out = np.empty(pivot.shape)
    start[0] = pivot[0, 0]
    start[1] = pivot[0, 1]
    start[2] = 0.0
    start[3] = 0.0
    for _ in range(3):
        chain._begin(s, start)
        for i in range(len(pivot)):
            gripper_sway.step(pivot[i, 0], pivot[i, 1], pivot[i, 2], p, at, s, 0, dt, out[i])
        chain._correct_start(p, at, measured, out, 0, len(pivot), dt, start)


@njit(cache=True, nogil=True)
def _begin_lane(p, memory, command, drive, speed, joints, kinds, gains, low, high, dt):
    """Fill the memories of one lane as if the command had been held for long, then put the axes in their places."""
    for i in range(len(kinds)):
        s = memory[i]
        s[_POSITION] = drive[i]
        s[_SPEED] = 0.0
        if kinds[i] != chain.FORCE:
            chain.advance(command[i], p, i * layout.AXIS_WIDTH, s, 0, len(s), kinds[i], gains[i], low[i], high[i], dt)
        s[_POSITION] = drive[i]
        s[_SPEED] = speed[i]
        s[_PLAY] = joints[i]


@njit(cache=True, nogil=True)
def _advance_lanes(first, last, thetas, memory, command, kinds, gains, low, high, dt):
    size = memory.shape[2]
    for lane in range(first, last):
        for i in range(len(kinds)):
            b = i * layout.AXIS_WIDTH
            chain.advance(command[lane, i], thetas[lane], b, memory[lane, i], 0, size, kinds[i], gains[i], low[i], high[i], dt)


@njit(cache=True, nogil=True)
def _joint_lanes(first, last, thetas, memory, plays, by_cylinder, tables, grid, drive, joints, structure):
    """Drive → joint sensors → structure. Without a linkage the table is NaN, and so are the joints."""
    for lane in range(first, last):
        p = thetas[lane]
        for i in range(len(by_cylinder)):
            b = i * layout.AXIS_WIDTH
            s = memory[lane, i]
            x = s[_POSITION]
            drive[lane, i] = x
            if by_cylinder[i]:
                x = chain.look_up(x, tables[i], grid[i, 0], grid[i, 1])
            if np.isnan(x):
                joints[lane, i] = np.nan
                structure[lane, i] = np.nan
                continue
            x = backlash.step(x, p, b + _PLAY_DRIVE, s, _PLAY)
            joints[lane, i] = x
            structure[lane, i] = backlash.step(x, p, b + _PLAY_STRUCTURE, plays[lane], i) + p[b + _OFFSET]


@njit(cache=True, nogil=True)
def _tip_lanes(
    first, last, tip_thetas, thetas, alike, base, at, structure, origins, axes, prismatic, order, end, swing, dt, ee, tool
):
    """Structure → tip → tool. The tip adds the joint offsets itself, so they are taken out before.

    Lanes that are ``alike`` go through the kinematics together, as the rows of one run.
    """
    rows = np.empty((last - first, structure.shape[1]))
    for lane in range(first, last):
        for i in range(structure.shape[1]):
            rows[lane - first, i] = structure[lane, i] - tip_thetas[lane, i * layout.AXIS_WIDTH + _OFFSET]
    if alike:
        chain.tip(tip_thetas[first], base, rows, origins, axes, prismatic, order, end, ee[first:last])
    else:
        for lane in range(first, last):
            row = rows[lane - first : lane - first + 1]
            chain.tip(tip_thetas[lane], base, row, origins, axes, prismatic, order, end, ee[lane : lane + 1])
    for lane in range(first, last):
        gripper_sway.step(ee[lane, 0], ee[lane, 1], ee[lane, 2], thetas[lane], at, swing[lane], 0, dt, tool[lane])
