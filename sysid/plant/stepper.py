"""The compiled chain one step at a time, for many lanes at once: for environments and the PyBullet world.

Same step functions as :func:`sysid.plant.free_run`; the caller runs the loop over time. After ``reset`` the state is that of
sample 0; a step with the command of sample k leads to sample k + 1. Where a recording has another order of command and sample,
:func:`held_commands` and :func:`step_commands` give the command of each step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.effects import gripper_sway, input_delay
from sysid.effects.compiled import kernel
from sysid.errors import SettingsError
from sysid.machine import Machine
from sysid.machine.rigid_body import moves_masses
from sysid.plant import axis_loop, chain, layout, residual, servo_arm, swing
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.machine_arrays import FORCE, HIGH, KIND, LOW, POSITION, SERVO
from sysid.plant.machine_run import advance, enter, observe, settling
from sysid.plant.model import WORKERS, compile_plant, frozen, in_parallel
from sysid.plant.plant import Plant
from sysid.plant.pose import SCRATCH
from sysid.plant.residual import check_step, new_memory
from sysid.plant.rollout import MachineState, StartStates, run_steps, start_states, true_run
from sysid.plant.settled_pose import settled_loads
from sysid.plant.stretches import held_for

Array = npt.NDArray[np.float64]

#: Up to this number of lanes one core is faster than two.
_SERIAL_LANES = 512


@dataclass(frozen=True)
class LaneState:
    """All lanes at one sample; fresh arrays, NaN where the plant has no linkage or no URDF.

    Args:
        drive: what the commands move, cylinder [m] or joint [rad or m], (lanes, axes).
        joints: as the joint sensors read them, (lanes, axes).
        structure: joints of the structure, behind backlash and offset of the sensors, (lanes, axes).
        ee, tool: in the frame they are measured in, (lanes, 3) [m].
    """

    drive: Array
    joints: Array
    structure: Array
    ee: Array
    tool: Array


class Stepper:
    """A plant that is advanced step by step in independent ``lanes``.

    Args:
        rate_hz: steps per second.
        lanes: number of independent copies.
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
        if moves_masses(plant.machine):
            found = "force axes that move links with masses, of which there are no forward dynamics"
            remedy = "sysid export PLANT --to mjcf writes the arm with its masses and friction for MuJoCo."
            raise SettingsError(where, found, "axes driven by position or velocity, or links without masses", remedy)
        check_step(plant.residuals, 1.0 / rate_hz)
        self.plant, self.lanes, self.rate_hz = plant, lanes, rate_hz
        self.model = model = compile_plant(plant)
        self.axes = axes = model.axes
        self.dt = 1.0 / rate_hz
        self.thetas = _checked_thetas(model.theta, thetas, lanes, where)
        self._memory = np.full((lanes, axes * layout.axis_memory(self.dt)), np.nan)
        self._load = np.zeros((lanes, axes))
        self._swing = np.full((lanes, gripper_sway.MEMORY), np.nan)
        self._out = LaneState(*(np.full((lanes, n), np.nan) for n in (axes, axes, axes, 3, 3)))
        self._left = None if model.nets is None else np.tile(new_memory(model.nets), (lanes, 1, 1))
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
        seconds: float = 0.0,
    ) -> LaneState:
        """Put lanes at rest and return the state of all lanes.

        All arrays may have one row for all lanes, or one row for each lane that is reset.

        Args:
            joints: as the sensors read them, (axes,) or (rows, axes) [rad or m].
            drive: position of the drives; else from the joints through the linkage, in the middle of the backlash. A servo
                begins on the flank that carries its links.
            speed: of force and servo axes at the start [m/s or rad/s]; else zero.
            commands: held for a long time before; else zero, or the position of a servo axis. The command of a position axis is
                its position.
            swing: position (x, y) and speed (x, y) of the tool, (4,) or (rows, 4); else it hangs at rest.
            which: indices of the lanes to reset, or a mask; else all.
            seconds: time for which the machine has been warming up.

        Raises:
            SettingsError: a shape does not fit, or a joint cannot be turned into a cylinder position.
        """
        lanes = np.arange(self.lanes) if which is None else np.arange(self.lanes)[np.asarray(which)]
        rows, n, arrays = len(lanes), self.axes, self.model.arrays
        read = self._rows("joints", joints, rows, n)
        straight = self._joints_without_sag(read, self.thetas[lanes])
        begin = self._drive_of(straight) if drive is None else self._rows("drive", drive, rows, n)
        begin = np.clip(begin, arrays.axes[:, LOW], arrays.axes[:, HIGH])
        command = self._rows("commands", 0.0 if commands is None else commands, rows, n)
        held = commands is None and self.model.coupled
        command = np.where((arrays.axes[:, KIND] == POSITION) | held, begin, command)
        start = self._rows("speed", 0.0 if speed is None else speed, rows, n)
        hanging = np.full((rows, gripper_sway.MEMORY), np.nan)
        if swing is not None:
            hanging[:, :4] = self._rows("swing", swing, rows, 4)
        for row, lane in enumerate(lanes):
            p, s, load = self.thetas[lane], self._memory[lane], self._load[lane]
            _begin_lane(p, arrays, s, begin[row], start[row], straight[row], self.dt)
            if self._left is not None:
                _reset_residuals(self._left[lane])
            load[:] = 0.0
            self._settle(int(lane), np.ones(n, dtype=np.bool_))
            self._swing[lane] = hanging[row]
            self._observe(int(lane), int(lane) + 1)  # how it sags there ...
            _hold_command(p, arrays, s, load, command[row], seconds, self.dt)  # ... and what the valves make of it
        self._ready[lanes] = True
        return self._state()

    def begin(self, recording: Recording, row: int) -> LaneState:
        """Set all lanes to the state of the free run of ``recording`` at ``row``, where a stretch begins.

        A lane with other parameters gets the same positions, speeds and valve openings.
        """
        arrays = self.model.arrays
        starts = start_states(self.model, recording)
        before = run_steps(self.model, recording, starts, row)[1]
        states, fresh = begin_states(starts, before, row)
        for lane, theta in enumerate(self.thetas):
            self._load[lane], left = before.load, None
            if self._left is not None:
                left = self._left[lane]
                left[:] = before.networks
            _enter_lane(
                theta, arrays, self._memory[lane], self._load[lane], states, fresh, starts.commands[row], row, self.dt,
                self.model.nets, left,
            )  # fmt: skip
        self._swing[:] = np.nan
        for lane in range(self.lanes):
            self._settle(lane, fresh)
        if self.model.has_tool(self.model.theta, recording) and not np.isnan(self._out.ee[0]).any():
            rest = slice(row, None)
            tip = true_run(self.model, recording)[2]
            tool = self.model.true_point(self.model.theta[None], recording, "tool")[0]
            self._swing[:] = swing_start(self.plant, tip[rest], tool[rest], self.rate_hz)
        self._observe(0, self.lanes)
        self._ready[:] = True
        return self._state()

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
                first, last, self.thetas, self.model.arrays, self._memory, self._load, command, self.dt,
                servo_arm.workspace(self.model.arrays), self.model.nets, self._left,
            )  # fmt: skip
            self._observe(first, last)

        workers = min(WORKERS, 1 + self.lanes // _SERIAL_LANES)
        in_parallel(stretch, workers, 1 << 30)
        return self._state()

    def state(self) -> dict[str, Array]:
        """The complete state, and the result of the last step; rows are lanes."""
        kept = {name: getattr(self, f"_{name}").copy() for name in ("memory", "load", "swing", "ready")}
        if self._left is not None:
            kept["left"] = self._left.copy()
        return kept | {f"out.{item.name}": getattr(self._out, item.name).copy() for item in fields(LaneState)}

    def restore(self, state: Mapping[str, Array]) -> LaneState:
        """Restore a :meth:`state` of this plant at this rate exactly; returns the state of all lanes.

        Raises:
            SettingsError: the state is of another number of lanes, or of another plant.
        """
        stage_net = self.state()
        for name, values in stage_net.items():
            found = np.shape(state.get(name, ()))
            if found != values.shape:
                raise SettingsError("stepper", f"a state with {name} of shape {found}", f"{values.shape}")
        for name in stage_net:
            holder, _, item = name.rpartition(".")
            place: Array = getattr(self._out, item) if holder else getattr(self, f"_{name}")
            place[:] = state[name]
        return self._state()

    @property
    def swing(self) -> Array:
        """Position (x, y) and speed (x, y) of the tool of each lane, (lanes, 4); NaN where no tool hangs."""
        return self._swing[:, :4].copy()

    def _observe(self, first: int, last: int) -> None:
        """Compute the outputs of lanes ``first … last`` from their states."""
        out = self._out
        _observe_lanes(
            first, last, self.thetas, self.model.arrays, self._memory, self._load, self._swing, self.dt, out.drive, out.joints,
            out.structure, out.ee, out.tool, self.model.nets, self._left,
        )  # fmt: skip

    def _settle(self, lane: int, fresh: npt.NDArray[np.bool_]) -> None:
        """Let the axes of a lane that begin (A,) settle under the load of their posture; the next observation is at rest."""
        for _ in range(settling(self.thetas[lane], self.axes)):
            self._observe(lane, lane + 1)
            _restart_structure_backlash(self._memory[lane], fresh)

    def _joints_without_sag(self, joints: Array, thetas: Array) -> Array:
        """Joints without sag from those that the sensors read, (rows, axes)."""
        at = np.arange(self.axes) * AXIS_WIDTH
        compliance, offset = thetas[:, at + AT.joint_compliance_drive], thetas[:, at + AT.joint_offset]
        if not self.model.posed or not compliance.any():
            return joints
        arrays, load = self.model.arrays, np.zeros(joints.shape)
        for row, theta in enumerate(thetas):
            straight = joints[row : row + 1] + offset[row]
            settled_loads(theta, arrays.links, arrays.base, straight, load[row : row + 1])
        return joints + compliance * np.nan_to_num(load)

    def _state(self) -> LaneState:
        out = self._out
        return LaneState(out.drive.copy(), out.joints.copy(), out.structure.copy(), out.ee.copy(), out.tool.copy())

    def _drive_of(self, joints: Array) -> Array:
        drive = joints.copy()
        for i, axis in enumerate(self.plant.machine.axes):
            if axis.drives != "cylinder":
                continue
            if axis.name not in self.plant.linkages:
                found = "no linkage: the cylinder position does not follow from the joint"
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
    """Commands of all axes in the rows of the plant, short gaps held, (n, axes); NaN where longer ones interrupt a run."""
    columns = []
    for axis in machine.axes:
        filled, stretches = held_for(machine, recording, axis.name)
        column = np.full(len(filled), np.nan)
        for first, last in stretches:
            column[first:last] = filled[first:last]
        columns.append(column)
    return np.column_stack(columns)


def step_commands(machine: Machine, commands: Array) -> Array:
    """Commands of n samples, (n, axes) → those of the n − 1 steps between them."""
    position = np.array([axis.actuation == "position" for axis in machine.axes])
    return np.where(position, commands[1:], commands[:-1])


def swing_start(plant: Plant, ee: Array, tool: Array, rate_hz: float) -> Array:
    """State of the tool before the first sample of a free run, from boom tip (n, 3) and measured tool (n, 3)."""
    start = np.empty(gripper_sway.MEMORY)
    last = int(np.argmax(np.append(np.isnan(ee[:, 0]), True)))
    at = layout.tool_place(len(plant.machine.axes))
    swing.start(plant.vector(), at, frozen(ee[:last].copy()), frozen(tool[:last].copy()), 1.0 / rate_hz, start)
    return start


def begin_states(starts: StartStates, before: MachineState, row: int) -> tuple[Array, npt.NDArray[np.bool_]]:
    """State (A, size) of the axes at ``row``, NaN without a command, and a mask of those that begin there (A,)."""
    states = before.memory.reshape(len(starts.edges), -1).copy()
    fresh = np.zeros(len(states), dtype=np.bool_)
    for i, edges in enumerate(starts.edges):
        here = np.flatnonzero((edges[:, 0] <= row) & (row < edges[:, 1]))
        if not len(here):
            states[i] = np.nan
        elif edges[here[0], 0] == row:
            states[i], fresh[i] = starts.states[i, here[0]], True
    return states, fresh


@kernel
def _begin_lane(p, arrays, s, drive, speed, joint, dt):
    """Initial positions and speeds of the axes, into the memory ``s`` (A · size,) of a lane."""
    size = len(s) // len(arrays.axes)
    for i in range(len(arrays.axes)):
        behind = np.nan if arrays.axes[i, KIND] == SERVO else joint[i]
        axis_loop.begin(s, i * size, size, drive[i], speed[i], behind, p, i * AXIS_WIDTH, 0, dt)


@kernel
def _hold_command(p, arrays, s, load, command, seconds, dt):
    """Fill the memory ``s`` of a lane for a command held for a long time under its ``load``, after ``seconds`` of warm-up."""
    size = len(s) // len(arrays.axes)
    for i in range(len(arrays.axes)):
        b, m = i * AXIS_WIDTH, i * size
        warm = math.exp(-seconds / p[b + AT.temperature_drift + 1])
        s[m + STATE.temperature_drift] = warm
        if arrays.axes[i, KIND] == SERVO:
            s[m + STATE.first_order_lag] = command[i]
            input_delay.fill(command[i], p, b + AT.input_delay, s, m + STATE.input_delay, size - STATE.input_delay, dt)
        elif arrays.axes[i, KIND] != FORCE:
            chain.demand(command[i], p, s, m, size, arrays.axes, i, load[i], dt)
        s[m + STATE.temperature_drift] = warm


@kernel
def _enter_lane(p, arrays, s, load, states, fresh, command, row, dt, nets, t):
    """Set a lane to ``states`` (A, size) of a plant with other parameters; what depends on parameters is computed again."""
    size = len(s) // len(arrays.axes)
    for i in range(len(arrays.axes)):
        b, m = i * AXIS_WIDTH, i * size
        state = states[i]
        state[STATE.first_order_lag + 1] = np.nan
        state[STATE.command_rate_limit + 1] = np.nan
        state[STATE.oil_compressibility + 2] = np.nan
        state[STATE.second_order_lag + 2] = np.nan
        state[STATE.flexible_drive + 2] = np.nan
        state[STATE.temperature_drift] = math.exp(-row * dt / p[b + AT.temperature_drift + 1])
        state[STATE.temperature_drift + 1] = np.nan
        input_delay.retime(p, b + AT.input_delay, state, STATE.input_delay, dt)
        if fresh[i]:
            enter(p, arrays, i, s, size, load, state, command[i], dt, nets, t)
        else:
            for k in range(size):
                s[m + k] = state[k]


@kernel
def _restart_structure_backlash(s, fresh):
    size = len(s) // len(fresh)
    for i in range(len(fresh)):
        if fresh[i]:
            s[i * size + STATE.backlash_structure] = np.nan


@kernel
def _reset_residuals(t):
    for r in range(len(t)):
        residual.reset_memory(t[r])


@kernel
def _advance_lanes(first, last, thetas, arrays, memory, load, command, dt, servos, nets, left):
    demands = np.empty(len(arrays.axes))
    for lane in range(first, last):
        t = None if nets is None else left[lane]
        advance(thetas[lane], arrays, memory[lane], load[lane], demands, servos, command[lane], dt, nets, t)


@kernel
def _observe_lanes(first, last, thetas, arrays, memory, load, swing, dt, drive, joints, structure, ee, tool, nets, left):
    scratch = np.empty((len(arrays.links), SCRATCH))
    for lane in range(first, last):
        p = thetas[lane]
        t = None if nets is None else left[lane]
        observe(p, arrays, memory[lane], load[lane], scratch, drive[lane], joints[lane], structure[lane], ee[lane], nets, t)
        gripper_sway.step(ee[lane, 0], ee[lane, 1], ee[lane, 2], p, arrays.tool, swing[lane], 0, dt, tool[lane])
