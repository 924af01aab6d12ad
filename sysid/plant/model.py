"""A plant compiled into arrays: stages of recordings for many parameter vectors at once, on all cores."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.cores import cores
from sysid.datasets.recording import Recording
from sysid.errors import SettingsError
from sysid.machine import Machine
from sysid.machine.rigid_body import RigidBody, rigid_body
from sysid.plant import axis_run, layout, residual, sensing, servo_axis, stage_tip, swing
from sysid.plant.arm_dynamics import mass_ratios
from sysid.plant.gravity import gravity_load
from sysid.plant.layout import AT, AXIS_WIDTH, SIGNAL_WIDTH, neutral_vector
from sysid.plant.machine_arrays import KIND, ORDER, PASSIVE, POSITION, SERVO, VELOCITY, MachineArrays, machine_arrays
from sysid.plant.plant import LINKAGE, Plant
from sysid.plant.rate import rate_of
from sysid.plant.residual import Residual, ResidualArrays, StageResidual, check_step, new_memory, residual_arrays
from sysid.plant.servo_series import servo_series
from sysid.plant.stretches import Segments, held_for, split
from sysid.scratch import filled
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: The start of the backlash behind a measured cylinder, and the position of a run that follows another, are estimated from
#: this time [s].
START_WINDOW = 0.2
#: The position of the drive in its backlash at the start of a free run is estimated from this time after the first motion [s].
SETTLE_WINDOW = 10.0

#: Parameters of an axis that have no influence without a load.
_BY_LOAD = (AT.load_dependent_flow, AT.joint_compliance_drive)


@dataclass(frozen=True)
class Model:
    """Arrays of a plant for the kernels; most methods take lanes of parameter vectors, ``thetas`` (lanes, N), for ``theta``."""

    machine: Machine
    theta: Array
    arrays: MachineArrays
    linked: frozenset[str]
    streams: layout.Streams = field(default_factory=dict)
    residuals: tuple[Residual, ...] = ()
    nets: ResidualArrays | None = None
    rigid: RigidBody | None = None

    @property
    def axes(self) -> int:
        return len(self.machine.axes)

    @property
    def posed(self) -> bool:
        """Whether the machine has kinematics."""
        return self.arrays.posed

    @property
    def coupled(self) -> bool:
        """Whether the axes are servos that move one arm: all of them run together, or none."""
        return bool((self.arrays.axes[:, KIND] == SERVO).any())

    @property
    def links_move(self) -> bool:
        """Whether servos move links with masses, so that the motion of every joint acts on the others."""
        return self.coupled and bool(self.arrays.bodies[:, 0].any())

    def carried(self, axis: str) -> tuple[str, ...]:
        """The axis and those behind it in the chain, whose links move with it."""
        links = self.arrays.links[:-1]
        order = [int(row[ORDER]) for row in links if not row[PASSIVE]]
        return tuple(self.machine.axis_names[i] for i in order[order.index(self.axis_index(axis)) :])

    def axis_index(self, axis: str) -> int:
        return self.machine.axis_names.index(axis)

    def has_tool(self, theta: Array, recording: Recording) -> bool:
        """Whether the tool is predicted: machine.toml names its link, the plant lets it swing, or the recording measures it.

        Where it neither has a link nor swings, tool = ee (contract).
        """
        swings = bool(theta[self.arrays.tool] > 0.0)
        return self.machine.tool is not None or swings or not np.isnan(measured_point(recording, "tool")).all()

    # -- stages ----------------------------------------------------------------------------------------------------

    def drive(self, thetas: Array, recording: Recording, axis: str, restart_every: float | None = None) -> Array:
        """Command → the signal that it drives, free-running: (lanes, n).

        Load and pump share follow from the measured joints and the commands of the other axes. The start is that of a free run.
        ``restart_every`` [s] resets a moving axis to its measured position at this interval, for starting values of a fit;
        its valve keeps its state.
        """
        driven = self.machine.axis(axis).driven
        return self.sensed(thetas, driven, self._true_drive(thetas, recording, axis, restart_every), 1.0 / recording.rate_hz)

    def speed(self, thetas: Array, recording: Recording, axis: str) -> Array:
        """Command → rate of the signal that it drives, as its sensor measures it, free-running: (lanes, n) [m/s or rad/s]."""
        return self.sensed_rate(thetas, axis, self._true_drive(thetas, recording, axis), recording.rate_hz)

    def sensed_rate(self, thetas: Array, axis: str, driven: Array, rate_hz: float) -> Array:
        """True values of a driven signal (lanes, n) → readings of the sensor of its rate, see :mod:`sysid.plant.rate`."""
        return self.sensed(thetas, axis_signal(axis, "speed"), rate_of(driven, rate_hz), 1.0 / rate_hz)

    def _true_drive(self, thetas: Array, recording: Recording, axis: str, restart_every: float | None = None) -> Array:
        """:meth:`drive` without the sensor."""
        i, about, dt = self.axis_index(axis), self.machine.axis(axis), 1.0 / recording.rate_hz
        command, segments = self.held(recording, axis)
        if restart_every is not None:
            segments = split(segments, max(2, round(restart_every / dt)))
        if about.actuation == "servo":
            return self._true_servo(thetas, recording, i, command, segments)
        measured = self.true_signal(thetas, recording, about.driven)
        load, share = self.load(thetas, recording)[i], self.share(thetas, recording)
        size, window, settle = layout.axis_memory(dt), self.window(recording), round(SETTLE_WINDOW / dt)
        place: residual.ResidualStage = "force" if about.actuation == "force" else "command"
        commands = self.residual_commands(place, axis, recording)
        position, behind = np.full((2, len(thetas), len(command)), np.nan)

        def lane(k: int) -> None:
            axis_run.drive_axis(
                thetas[k], self.arrays, i, command, measured[k], load, share[k], segments, dt, window, settle, size, False,
                position[k], behind[k], self.stage_net(place, axis, commands),
            )  # fmt: skip

        in_parallel(lane, len(thetas), len(command))
        return behind

    def _true_servo(self, thetas: Array, recording: Recording, i: int, command: Array, segments: Segments) -> Array:
        """Joint of servo axis ``i``, beside the measured motion of the other joints: (lanes, n)."""
        dt, series = 1.0 / recording.rate_hz, servo_series(self.machine, self.arrays, self.theta, recording)
        out, begins = np.full((len(thetas), len(command)), np.nan), series.begins(i)
        alike = dict[bytes, list[int]]()  # lanes that have the series in common
        for k, theta in enumerate(thetas):
            alike.setdefault(mass_ratios(self.arrays, theta).tobytes(), []).append(k)
        most = min(TOGETHER, -(-sum(map(len, alike.values())) // free_cores()))
        groups = [part[k : k + most] for part in alike.values() for k in range(0, len(part), most)]

        def group(m: int) -> None:
            lanes, size = thetas[groups[m]], layout.axis_memory(dt)
            runs = np.full((len(lanes), len(command)), np.nan)
            servo_axis.drive_servo(lanes, self.arrays, i, command, series.of(i, lanes[0]), *begins, segments, dt, size, runs)
            out[groups[m]] = runs

        in_parallel(group, len(groups), len(command) * most)
        return out

    def joint(self, thetas: Array, recording: Recording, axis: str) -> Array:
        """Measured cylinder → joint through linkage, backlash and sag: (lanes, n)."""
        if axis not in self.linked:
            raise SettingsError(f"axis {axis}", "no linkage", LINKAGE)
        i, signal = self.axis_index(axis), axis_signal(axis, "joint")
        cylinder = self.true_signal(thetas, recording, axis_signal(axis, "cylinder"))
        measured, load = self.true_signal(thetas, recording, signal), self.load(thetas, recording)[i]
        window, out = self.window(recording), np.empty((len(thetas), len(recording)))
        dt = 1.0 / recording.rate_hz
        commands = self.residual_commands("joint", axis, recording)

        def lane(k: int) -> None:
            stage_net = self.stage_net("joint", axis, commands)
            axis_run.joint_axis(thetas[k], self.arrays, i, cylinder[k], measured[k], load, window, dt, out[k], stage_net)

        in_parallel(lane, len(thetas), len(recording))
        return self.sensed(thetas, signal, out, 1.0 / recording.rate_hz)

    def tip(self, thetas: Array, recording: Recording) -> Array:
        """Measured joints → end effector: (lanes, n, 3)."""
        if not self.posed:
            raise SettingsError(f"machine {self.machine.name}", "no URDF", "urdf and tip in machine.toml")
        names = [axis_signal(name, "joint") for name in self.machine.axis_names]
        true_signal = [self.true_signal(thetas, recording, name) for name in names]
        alike = all(part.strides[0] == 0 for part in true_signal)
        joints = np.stack([part[0] if alike else part for part in true_signal], axis=-1)
        out = np.empty((len(thetas), len(recording), 3))

        def lane(k: int) -> None:
            stage_tip.tip(thetas[k], self.arrays, joints if alike else joints[k], out[k])

        in_parallel(lane, len(thetas), len(recording))
        return self._sensed_point(thetas, "ee", out, 1.0 / recording.rate_hz)

    def tool(self, thetas: Array, recording: Recording) -> Array:
        """Measured end effector → hanging tool: (lanes, n, 3); the measured tool starts the swing."""
        pivot = self.true_point(thetas, recording, "ee")
        measured = self.true_point(thetas, recording, "tool")
        return self._sensed_point(
            thetas, "tool", self.tool_motion(thetas, pivot, measured, recording.rate_hz), 1.0 / recording.rate_hz
        )

    def tool_motion(self, thetas: Array, pivot: Array, measured: Array, rate_hz: float) -> Array:
        """True end effector (lanes, n, 3) → true tool; ``measured`` tool (lanes, n, 3) starts the swing."""
        out, pivot, measured = np.empty(pivot.shape), frozen(pivot), frozen(measured)

        def lane(k: int) -> None:
            swing.swing(thetas[k], self.arrays.tool, pivot[k], measured[k], 1.0 / rate_hz, out[k])

        in_parallel(lane, len(thetas), pivot.shape[1])
        return out

    def inverse(self, theta: Array, axis: str, x: Array, v: Array, a: Array, dt: float, load: Array | None = None) -> Array:
        """Command that a force axis needs for a motion: position, speed and acceleration, each (n,) → (n,) [N or N·m].

        ``load``: torque of the links on it (n,), which is not contained but causes friction; zero by default.
        """
        out = np.empty(len(v))
        carried = frozen(np.zeros(len(v)) if load is None else load)
        commands = np.zeros((len(v), self.axes)) if self.has_residual("force", axis, dt) else None
        stage_net = self.stage_net("force", axis, commands)
        motion = (frozen(x), frozen(v), frozen(a))
        axis_run.force_axis(theta, self.arrays, self.axis_index(axis), *motion, carried, dt, out, stage_net)
        return out

    # -- residual networks ---------------------------------------------------------------------------------------------

    def has_residual(self, stage: residual.ResidualStage, axis: str, dt: float) -> bool:
        """Whether that stage has a residual network.

        Raises:
            SettingsError: steps of ``dt`` are longer than its interval.
        """
        found = [item for item in self.residuals if item.key == (stage, axis)]
        check_step(found, dt)
        return bool(found)

    def stage_net(self, stage: residual.ResidualStage, axis: str, commands: Array | None) -> StageResidual | None:
        """The network of a stage with a fresh memory; None where ``commands`` are None."""
        if commands is None or self.nets is None:
            return None
        row = next(k for k, item in enumerate(self.residuals) if item.key == (stage, axis))
        return StageResidual(self.nets, row, frozen(commands), new_memory(self.nets)[row])

    def residual_commands(self, stage: residual.ResidualStage, axis: str, recording: Recording) -> Array | None:
        """:meth:`commands_by_step` for the network of a stage; None where the stage has none."""
        known = self.has_residual(stage, axis, 1.0 / recording.rate_hz)
        return self.commands_by_step(recording, self.axis_index(axis)) if known else None

    def commands_by_step(self, recording: Recording, i: int) -> Array:
        """Commands of all axes during each step that begins at a sample, (n, A); for the steps of axis ``i``."""
        columns = []
        for k, name in enumerate(self.machine.axis_names):
            command = self.held(recording, name)[0]
            columns.append(np.append(command[1:], command[-1:]) if self.arrays.axes[k, KIND] == POSITION else command)
        return np.column_stack(columns)

    # -- further inputs of the stages --------------------------------------------------------------------------------

    def held(self, recording: Recording, axis: str) -> tuple[Array, Segments]:
        """:func:`held_for` of a command, cached in the recording."""
        key = "held", axis, self.machine.command_shift(axis)
        known: tuple[Array, Segments] | None = recording.derived.get(key)
        if known is None:
            known = recording.derived[key] = held_for(self.machine, recording, axis)
        return known

    def window(self, recording: Recording) -> int:
        """Samples of :data:`START_WINDOW`."""
        return max(3, round(START_WINDOW * recording.rate_hz))

    def load(self, thetas: Array, recording: Recording, seconds: float = math.inf) -> Array:
        """:func:`sysid.plant.gravity.gravity_load` of every axis, (A, n), cached; zero where no lane has an effect of it.

        ``seconds``: only within so much of each stretch with commands, elsewhere zero.
        """
        places = [i * AXIS_WIDTH + at for i in range(self.axes) for at in _BY_LOAD]
        if not thetas[:, places].any() and not self._uses_load:
            return np.zeros((self.axes, len(recording)))
        if seconds < math.inf:
            stretches = [self.stretches(recording, name, seconds) for name in self.machine.axis_names]
            return np.ascontiguousarray(gravity_load(self.machine, recording, np.unique(np.vstack(stretches), axis=0)).T)
        known: tuple[Machine, Array] | None = recording.derived.get("load")
        if known is None or known[0] is not self.machine:
            known = recording.derived["load"] = (self.machine, np.ascontiguousarray(gravity_load(self.machine, recording).T))
        return known[1]

    @property
    def _uses_load(self) -> bool:
        """Whether a residual network has a load as input."""
        return self.nets is not None and bool(self.nets.scale[:, -3].any())

    def stretches(self, recording: Recording, axis: str, seconds: float = math.inf) -> Segments:
        """First and last+1 sample of the first ``seconds`` of each stretch with commands, (m, 2)."""
        segments = self.held(recording, axis)[1]
        if seconds == math.inf:
            return segments
        ends = np.minimum(segments[:, 1], segments[:, 0] + round(seconds * recording.rate_hz))
        return np.column_stack([segments[:, 0], ends])

    def share(self, thetas: Array, recording: Recording, seconds: float = math.inf) -> Array:
        """Share of the velocity axes' demand that the pump supplies, (lanes, n); for the first ``seconds`` of each stretch."""
        place = self.arrays.machine + AT.pump_flow_limit
        neutral = neutral_vector(self.axes)[place]
        if (thetas[:, place] >= neutral).all():
            return np.broadcast_to(filled(len(recording), 1.0), (len(thetas), len(recording)))
        dt = 1.0 / recording.rate_hz
        limited = np.flatnonzero(thetas[:, place] < neutral)
        # The demand depends on the velocity axes only: lanes that are equal in these share it.
        moved = [i for i in range(self.axes) if self.arrays.axes[i, KIND] == VELOCITY]
        blocks = np.concatenate([np.arange(i * AXIS_WIDTH, (i + 1) * AXIS_WIDTH) for i in moved])
        rows: list[int] = []
        known: dict[bytes, int] = {}
        of_lane = np.empty(len(limited), dtype=np.int64)
        for k, lane_of in enumerate(limited):
            of_lane[k] = known.setdefault(thetas[lane_of, blocks].tobytes(), len(rows))
            if of_lane[k] == len(rows):
                rows.append(int(lane_of))
        total, load = np.zeros((len(rows), len(recording))), self.load(thetas, recording, seconds)
        size = layout.axis_memory(dt)
        names = self.machine.axis_names
        inputs = [(i, self.held(recording, names[i])[0], self.stretches(recording, names[i], seconds)) for i in moved]

        def lane(k: int) -> None:
            for i, command, segments in inputs:
                axis_run.add_demand(thetas[rows[k]], self.arrays, i, command, load[i], segments, dt, size, total[k])

        in_parallel(lane, len(rows), len(recording) * len(moved))
        out = np.ones((len(thetas), len(recording)))
        out[limited] = np.minimum(1.0, thetas[limited, place, None] / np.maximum(total[of_lane], 1e-12))
        return frozen(out)

    # -- sensors -----------------------------------------------------------------------------------------------------

    def sensed(self, thetas: Array, signal: str, true: Array, dt: float) -> Array:
        """True values (lanes, n) → readings of the signal's sensor; the same array where all sensors are ideal."""
        place = self._sensor(thetas, signal)
        if place is None:
            return true
        out = np.empty(true.shape)
        for k in range(len(thetas)):
            sensing.sensed(thetas[k], place, np.ascontiguousarray(true[k]), dt, out[k])
        return out

    def true_signal(self, thetas: Array, recording: Recording, signal: str) -> Array:
        """True values that follow from the recorded readings of the signal's sensor (inverse sensor model), (lanes, n)."""
        values, place = recording.values(signal), self._sensor(thetas, signal)
        if place is None:
            return np.broadcast_to(values, (len(thetas), len(values)))
        out = np.empty((len(thetas), len(values)))
        for k in range(len(thetas)):
            sensing.true_signal(thetas[k], place, values, 1.0 / recording.rate_hz, out[k])
        return frozen(out)

    def _sensor(self, thetas: Array, signal: str) -> int | None:
        """Index of the signal's sensor in ``theta``; None where it is ideal in all lanes."""
        place = layout.signal_place(self.machine.axis_names, signal)
        neutral = neutral_vector(self.axes)[place : place + SIGNAL_WIDTH]
        return None if (thetas[:, place : place + SIGNAL_WIDTH] == neutral).all() else place

    def _sensed_point(self, thetas: Array, point: str, true: Array, dt: float) -> Array:
        for c, signal in enumerate(point_signals(point)):
            readings = self.sensed(thetas, signal, true[:, :, c], dt)
            if readings.base is not true:
                true[:, :, c] = readings
        return true

    def true_point(self, thetas: Array, recording: Recording, point: str) -> Array:
        """:meth:`true_signal` of ``ee`` or ``tool``, (lanes, n, 3); a row with any coordinate missing is all NaN."""
        parts = [self.true_signal(thetas, recording, signal) for signal in point_signals(point)]
        if all(part.strides[0] == 0 for part in parts):
            values = mask_incomplete_rows(np.stack([part[0] for part in parts], axis=-1))
            return np.broadcast_to(values, (len(thetas), *values.shape))
        return mask_incomplete_rows(np.stack(parts, axis=-1))


def compile_plant(plant: Plant) -> Model:
    """The arrays of a plant."""
    nets = residual_arrays(plant.machine, plant.residuals)
    linked = frozenset(plant.linkages)
    arrays, rigid = machine_arrays(plant), rigid_body(plant.machine)
    return Model(plant.machine, plant.vector(), arrays, linked, plant.streams, plant.residuals, nets, rigid)


def frozen(values: Array) -> Array:
    """A read-only view, so that recorded and computed inputs have one type and kernels compile once."""
    view = values.view()
    view.setflags(write=False)
    return view


def mask_incomplete_rows(values: Array) -> Array:
    """Rows (…, 3) with any coordinate missing are all NaN."""
    values[np.isnan(values).any(axis=-1)] = np.nan
    return values


def measured_point(recording: Recording, point: str) -> Array:
    """``ee`` or ``tool`` as (n, 3); a row with any coordinate missing is all NaN."""
    return mask_incomplete_rows(np.column_stack([recording.values(signal) for signal in point_signals(point)]))


#: Cores for the lanes.
WORKERS = cores()
_pool: ThreadPoolExecutor | None = None
_counting = threading.Lock()
#: Lanes of servo axes that one call runs side by side: more than these are no faster each.
TOGETHER = 4
#: Number of threads that keep a core busy each.
_busy = 0
#: Fewer steps than this are faster on one core than on several.
SERIAL = 20_000


@contextmanager
def core_taken() -> Iterator[None]:
    """While this thread keeps a core busy by itself: :func:`in_parallel` of other threads leaves that core to it."""
    global _busy
    with _counting:
        _busy += 1
    try:
        yield
    finally:
        with _counting:
            _busy -= 1


def free_cores() -> int:
    """Cores for the lanes of a thread, at least one."""
    return max(WORKERS - max(_busy - 1, 0), 1)


def in_parallel(lane: Callable[[int], None], count: int, samples: int) -> None:
    """Run ``lane(0) … lane(count − 1)`` of ``samples`` steps each; on all free cores where that is faster.

    The kernels release the interpreter lock.
    """
    global _pool
    workers = min(free_cores(), count)
    if workers <= 1 or count * samples < SERIAL:
        for i in range(count):
            lane(i)
        return
    if _pool is None:
        _pool = ThreadPoolExecutor(WORKERS, thread_name_prefix="sysid-lane")

    def stretch(worker: int) -> None:
        for i in range(worker, count, workers):
            lane(i)

    list(_pool.map(stretch, range(workers)))
