"""A plant made ready for the compiled kernels: stages of recordings for many parameter vectors at once, over all cores."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.errors import SettingsError
from sysid.machine import Machine
from sysid.plant import axis_run, layout, residual, sensing, stage_tip, swing
from sysid.plant.gravity import gravity_load
from sysid.plant.layout import AT, AXIS_WIDTH, SIGNAL_WIDTH, neutral_vector
from sysid.plant.machine_arrays import KIND, POSITION, VELOCITY, MachineArrays, rig_of
from sysid.plant.plant import Plant
from sysid.plant.residual import Residual, ResidualArrays, StageResidual, check_step, memory_of, nets_of
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]
Segments = npt.NDArray[np.int64]

#: Where a play stands behind a measured cylinder is taken from this stretch [s]; so is the place of a run that goes on from
#: the one before it.
START_WINDOW = 0.2
#: The side of a play on which a free run starts is taken from this stretch [s].
SETTLE_WINDOW = 10.0
#: A command may be missing this long [s] before the free run restarts.
COMMAND_GAP = 0.1


#: Parameters of an axis that do nothing without a load.
_BY_LOAD = (AT.load_dependent_flow, AT.joint_compliance_drive)


@dataclass(frozen=True)
class Model:
    """What the kernels need of a plant; ``theta`` (N,) may be replaced by lanes of other values, ``thetas`` (lanes, N)."""

    machine: Machine
    theta: Array
    rig: MachineArrays
    linked: frozenset[str]
    streams: layout.Streams = field(default_factory=dict)
    residuals: tuple[Residual, ...] = ()
    nets: ResidualArrays | None = None

    @property
    def axes(self) -> int:
        return len(self.machine.axes)

    @property
    def posed(self) -> bool:
        """Whether the machine has kinematics."""
        return self.rig.posed

    def axis_index(self, axis: str) -> int:
        return self.machine.axis_names.index(axis)

    def has_tool(self, theta: Array, recording: Recording) -> bool:
        """Whether the tool is predicted: machine.toml names its link, the plant lets it swing, or the recording measures it.

        Where it neither has a link nor swings, tool = ee (contract).
        """
        swings = bool(theta[self.rig.tool] > 0.0)
        return self.machine.tool is not None or swings or not np.isnan(measured_point(recording, "tool")).all()

    # -- stages ----------------------------------------------------------------------------------------------------

    def drive(self, thetas: Array, recording: Recording, axis: str, restart_every: float | None = None) -> Array:
        """Command → the signal that it drives, free-running: (lanes, n).

        Load and pump share are those at the measured joints and at the other axes' commands. It starts where a free run does.
        ``restart_every`` [s] puts a moving axis where the measurement has it again and again, for starting values of a fit;
        its valve goes on as it is.
        """
        i, about, dt = self.axis_index(axis), self.machine.axis(axis), 1.0 / recording.rate_hz
        command, segments = self.held(recording, axis)
        if restart_every is not None:
            segments = _shorter(segments, max(2, round(restart_every / dt)))
        measured = self.believed(thetas, recording, about.driven)
        load, share = self.load(thetas, recording)[i], self.share(thetas, recording)
        size, window, settle = layout.axis_memory(dt), self.window(recording), round(SETTLE_WINDOW / dt)
        place: residual.Place = "force" if about.actuation == "force" else "command"
        commands = self.in_steps(recording, i) if self.carries(place, axis, dt) else None
        position, behind = np.full((2, len(thetas), len(command)), np.nan)

        def lane(k: int) -> None:
            axis_run.drive_axis(
                thetas[k], self.rig, i, command, measured[k], load, share[k], segments, dt, window, settle, size, False,
                position[k], behind[k], self.own(place, axis, commands),
            )  # fmt: skip

        in_parallel(lane, len(thetas), len(command))
        return self.sensed(thetas, about.driven, behind, dt)

    def joint(self, thetas: Array, recording: Recording, axis: str) -> Array:
        """Measured cylinder → joint through linkage, play and sag: (lanes, n)."""
        if axis not in self.linked:
            raise SettingsError(f"axis {axis}", "no linkage", "geometry in machine.toml or a fitted actuator network")
        i, signal = self.axis_index(axis), axis_signal(axis, "joint")
        cylinder = self.believed(thetas, recording, axis_signal(axis, "cylinder"))
        measured, load = self.believed(thetas, recording, signal), self.load(thetas, recording)[i]
        window, out = self.window(recording), np.empty((len(thetas), len(recording)))
        dt = 1.0 / recording.rate_hz
        commands = self.in_steps(recording, i) if self.carries("joint", axis, dt) else None

        def lane(k: int) -> None:
            own = self.own("joint", axis, commands)
            axis_run.joint_axis(thetas[k], self.rig, i, cylinder[k], measured[k], load, window, dt, out[k], own)

        in_parallel(lane, len(thetas), len(recording))
        return self.sensed(thetas, signal, out, 1.0 / recording.rate_hz)

    def tip(self, thetas: Array, recording: Recording) -> Array:
        """Measured joints → end effector: (lanes, n, 3)."""
        if not self.posed:
            raise SettingsError(f"machine {self.machine.name}", "no URDF", "urdf and tip in machine.toml")
        names = [axis_signal(name, "joint") for name in self.machine.axis_names]
        believed = [self.believed(thetas, recording, name) for name in names]
        alike = all(part.strides[0] == 0 for part in believed)
        joints = np.stack([part[0] if alike else part for part in believed], axis=-1)
        out = np.empty((len(thetas), len(recording), 3))

        def lane(k: int) -> None:
            stage_tip.tip(thetas[k], self.rig, joints if alike else joints[k], out[k])

        in_parallel(lane, len(thetas), len(recording))
        return self._sensed_point(thetas, "ee", out, 1.0 / recording.rate_hz)

    def tool(self, thetas: Array, recording: Recording) -> Array:
        """Measured end effector → hanging tool: (lanes, n, 3); the measured tool starts the swing."""
        pivot = self.believed_point(thetas, recording, "ee")
        measured = self.believed_point(thetas, recording, "tool")
        return self._sensed_point(
            thetas, "tool", self.hang(thetas, pivot, measured, recording.rate_hz), 1.0 / recording.rate_hz
        )

    def hang(self, thetas: Array, pivot: Array, measured: Array, rate_hz: float) -> Array:
        """True end effector (lanes, n, 3) → true tool; ``measured`` tool (lanes, n, 3) starts the swing."""
        out, pivot, measured = np.empty(pivot.shape), frozen(pivot), frozen(measured)

        def lane(k: int) -> None:
            swing.swing(thetas[k], self.rig.tool, pivot[k], measured[k], 1.0 / rate_hz, out[k])

        in_parallel(lane, len(thetas), pivot.shape[1])
        return out

    def inverse(self, theta: Array, axis: str, x: Array, v: Array, a: Array, dt: float) -> Array:
        """Force that a force axis needs for a motion: position, speed and acceleration, each (n,) → (n,) [N or N·m]."""
        out = np.empty(len(v))
        commands = np.zeros((len(v), self.axes)) if self.carries("force", axis, dt) else None
        own = self.own("force", axis, commands)
        axis_run.force_axis(theta, self.rig, self.axis_index(axis), frozen(x), frozen(v), frozen(a), dt, out, own)
        return out

    # -- what no effect explains ---------------------------------------------------------------------------------------

    def carries(self, stage: residual.Place, axis: str, dt: float) -> bool:
        """Whether a network sits at that stage.

        Raises:
            SettingsError: it cannot be run with steps of ``dt``.
        """
        found = [item for item in self.residuals if item.key == (stage, axis)]
        check_step(found, dt)
        return bool(found)

    def own(self, stage: residual.Place, axis: str, commands: Array | None) -> StageResidual | None:
        """The network of a stage with a fresh memory; None where ``commands`` are None."""
        if commands is None or self.nets is None:
            return None
        row = next(k for k, item in enumerate(self.residuals) if item.key == (stage, axis))
        return StageResidual(self.nets, row, frozen(commands), memory_of(self.nets)[row])

    def in_steps(self, recording: Recording, i: int) -> Array:
        """Commands in force during each step that begins at a sample, (n, A); for the steps of axis ``i``."""
        columns = []
        for k, name in enumerate(self.machine.axis_names):
            command = self.held(recording, name)[0]
            columns.append(np.append(command[1:], command[-1:]) if self.rig.axes[k, KIND] == POSITION else command)
        return np.column_stack(columns)

    # -- what stages take from elsewhere ---------------------------------------------------------------------------------

    def held(self, recording: Recording, axis: str) -> tuple[Array, Segments]:
        """:func:`held` of a command, remembered: a fit asks for it thousands of times."""
        known: tuple[Array, Segments] | None = recording.derived.get(("held", axis))
        if known is None:
            known = recording.derived["held", axis] = held(recording.values(axis_signal(axis, "command")), recording.rate_hz)
        return known

    def window(self, recording: Recording) -> int:
        """Samples of :data:`START_WINDOW`."""
        return max(3, round(START_WINDOW * recording.rate_hz))

    def load(self, thetas: Array, recording: Recording, seconds: float = math.inf) -> Array:
        """:func:`sysid.plant.gravity.gravity_load` of every axis, (A, n), remembered; zero where no lane has an effect of it.

        ``seconds``: only within so much of each stretch with commands, elsewhere zero.
        """
        places = [i * AXIS_WIDTH + at for i in range(self.axes) for at in _BY_LOAD]
        if not thetas[:, places].any() and not self._weighed:
            return np.zeros((self.axes, len(recording)))
        if seconds < math.inf:
            stretches = [self.stretches(recording, name, seconds) for name in self.machine.axis_names]
            return np.ascontiguousarray(gravity_load(self.machine, recording, np.unique(np.vstack(stretches), axis=0)).T)
        known: tuple[Machine, Array] | None = recording.derived.get("load")
        if known is None or known[0] is not self.machine:
            known = recording.derived["load"] = (self.machine, np.ascontiguousarray(gravity_load(self.machine, recording).T))
        return known[1]

    @property
    def _weighed(self) -> bool:
        """Whether a network looks at a load."""
        return self.nets is not None and bool(self.nets.scale[:, -3].any())

    def stretches(self, recording: Recording, axis: str, seconds: float = math.inf) -> Segments:
        """First and last+1 sample of the first ``seconds`` of each stretch with commands, (m, 2)."""
        segments = self.held(recording, axis)[1]
        if seconds == math.inf:
            return segments
        ends = np.minimum(segments[:, 1], segments[:, 0] + round(seconds * recording.rate_hz))
        return np.column_stack([segments[:, 0], ends])

    def share(self, thetas: Array, recording: Recording, seconds: float = math.inf) -> Array:
        """What the pump feeds of the velocity axes' demand, (lanes, n); within the first ``seconds`` of each stretch."""
        place = self.rig.machine + AT.pump_flow_limit
        neutral = neutral_vector(self.axes)[place]
        if (thetas[:, place] >= neutral).all():
            return np.broadcast_to(np.ones(len(recording)), (len(thetas), len(recording)))
        dt = 1.0 / recording.rate_hz
        limited = np.flatnonzero(thetas[:, place] < neutral)
        # The demand does not depend on the limit: lanes that differ in it alone, or elsewhere, share theirs.
        moved = [i for i in range(self.axes) if self.rig.axes[i, KIND] == VELOCITY]
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
                axis_run.add_demand(thetas[rows[k]], self.rig, i, command, load[i], segments, dt, size, total[k])

        in_parallel(lane, len(rows), len(recording) * len(moved))
        out = np.ones((len(thetas), len(recording)))
        out[limited] = np.minimum(1.0, thetas[limited, place, None] / np.maximum(total[of_lane], 1e-12))
        return frozen(out)

    # -- sensors -----------------------------------------------------------------------------------------------------

    def sensed(self, thetas: Array, signal: str, true: Array, dt: float) -> Array:
        """True values (lanes, n) → what the signal's sensor says; the same array where all sensors read the truth."""
        place = self._sensor(thetas, signal)
        if place is None:
            return true
        out = np.empty(true.shape)
        for k in range(len(thetas)):
            sensing.sensed(thetas[k], place, np.ascontiguousarray(true[k]), dt, out[k])
        return out

    def believed(self, thetas: Array, recording: Recording, signal: str) -> Array:
        """What must be true while the signal's sensor says what was recorded, (lanes, n)."""
        values, place = recording.values(signal), self._sensor(thetas, signal)
        if place is None:
            return np.broadcast_to(values, (len(thetas), len(values)))
        out = np.empty((len(thetas), len(values)))
        for k in range(len(thetas)):
            sensing.believed(thetas[k], place, values, 1.0 / recording.rate_hz, out[k])
        return frozen(out)

    def _sensor(self, thetas: Array, signal: str) -> int | None:
        """Where the signal's sensor stands in ``theta``; None where it reads the truth in all lanes."""
        place = layout.signal_place(self.machine.axis_names, signal)
        neutral = neutral_vector(self.axes)[place : place + SIGNAL_WIDTH]
        return None if (thetas[:, place : place + SIGNAL_WIDTH] == neutral).all() else place

    def _sensed_point(self, thetas: Array, point: str, true: Array, dt: float) -> Array:
        for c, signal in enumerate(point_signals(point)):
            said = self.sensed(thetas, signal, true[:, :, c], dt)
            if said.base is not true:
                true[:, :, c] = said
        return true

    def believed_point(self, thetas: Array, recording: Recording, point: str) -> Array:
        """:meth:`believed` of ``ee`` or ``tool``, (lanes, n, 3); a row with any coordinate missing is all NaN."""
        parts = [self.believed(thetas, recording, signal) for signal in point_signals(point)]
        if all(part.strides[0] == 0 for part in parts):
            values = whole_rows(np.stack([part[0] for part in parts], axis=-1))
            return np.broadcast_to(values, (len(thetas), *values.shape))
        return whole_rows(np.stack(parts, axis=-1))


def compile_plant(plant: Plant) -> Model:
    """The arrays of a plant."""
    nets = nets_of(plant.machine, plant.residuals)
    linked = frozenset(plant.linkages)
    return Model(plant.machine, plant.vector(), rig_of(plant), linked, plant.streams, plant.residuals, nets)


def held(command: Array, rate_hz: float) -> tuple[Array, Segments]:
    """The command with short gaps held, and the stretches (first, last+1) between longer ones."""
    there = ~np.isnan(command)
    if not there.any():
        return np.zeros(len(command)), np.empty((0, 2), dtype=np.int64)
    index = np.where(there, np.arange(len(command)), -1)
    last = np.maximum.accumulate(index)
    age = np.arange(len(command)) - last
    usable = (last >= 0) & (age <= COMMAND_GAP * rate_hz)
    filled = np.where(usable, command[np.maximum(last, 0)], 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], usable, [False])).astype(np.int8)))
    return filled, edges.reshape(-1, 2).astype(np.int64)


def _shorter(segments: Segments, length: int) -> Segments:
    """Every stretch cut into pieces of at most ``length`` samples."""
    cut = [(k, min(k + length, last)) for first, last in segments for k in range(first, last, length)]
    return np.array(cut, dtype=np.int64).reshape(-1, 2)


def frozen(values: Array) -> Array:
    """A read-only view: kernels compile once where recorded and computed inputs are of one type."""
    view = values.view()
    view.setflags(write=False)
    return view


def whole_rows(values: Array) -> Array:
    """Rows (…, 3) with any coordinate missing are all NaN."""
    values[np.isnan(values).any(axis=-1)] = np.nan
    return values


def measured_point(recording: Recording, point: str) -> Array:
    """``ee`` or ``tool`` as (n, 3); a row with any coordinate missing is all NaN."""
    return whole_rows(np.column_stack([recording.values(signal) for signal in point_signals(point)]))


#: Cores that lanes are spread over.
WORKERS = max(1, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1))
_pool: ThreadPoolExecutor | None = None
#: Fewer steps than this run faster on one core than handed to several.
SERIAL = 20_000


def in_parallel(lane: Callable[[int], None], count: int, samples: int) -> None:
    """Run ``lane(0) … lane(count − 1)`` of ``samples`` steps each; on all cores where that is worth it.

    The kernels release the interpreter lock; every worker takes a stretch of lanes.
    """
    global _pool
    workers = min(WORKERS, count)
    if workers == 1 or count * samples < SERIAL:
        for i in range(count):
            lane(i)
        return
    if _pool is None:
        _pool = ThreadPoolExecutor(WORKERS, thread_name_prefix="sysid-lane")

    def stretch(worker: int) -> None:
        for i in range(worker, count, workers):
            lane(i)

    list(_pool.map(stretch, range(workers)))
