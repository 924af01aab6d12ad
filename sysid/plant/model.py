"""A plant made ready for the compiled kernels: constant arrays beside the parameter vector, and lanes over all cores."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.errors import SettingsError
from sysid.machine import Kinematics, Machine
from sysid.plant import chain, layout
from sysid.plant.plant import Plant
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: A free run starts from the median of this stretch [s] (contract).
START_WINDOW = 0.2
#: The side of a play on which a free run starts is taken from this stretch [s].
SETTLE_WINDOW = 10.0
#: A command may be missing this long [s] before the free run restarts.
COMMAND_GAP = 0.1

_KINDS = {"velocity": chain.VELOCITY, "position": chain.POSITION, "force": chain.FORCE}


@dataclass(frozen=True)
class Chain:
    """Kinematic constants in chain order, fixed joints merged (see :func:`sysid.plant.chain.tip`)."""

    origins: Array
    axes: Array
    prismatic: npt.NDArray[np.bool_]
    order: npt.NDArray[np.int64]
    end: Array


@dataclass(frozen=True)
class Model:
    """What the kernels need of a plant; ``theta`` (N,) may be replaced by lanes of other values."""

    machine: Machine
    theta: Array
    tables: dict[str, tuple[Array, float, float]]
    chain: Chain | None
    commands: dict[tuple[int, str], tuple[Recording, Array, npt.NDArray[np.int64]]] = field(
        default_factory=dict, repr=False, compare=False
    )

    @property
    def axes(self) -> int:
        return len(self.machine.axes)

    def drive(self, thetas: Array, recording: Recording, axis: str, restart_every: float | None = None) -> tuple[Array, Array]:
        """Free run of one axis from its command: (position of the drive, behind the play if it lies there), each (lanes, n).

        ``restart_every`` [s] restarts it from the measurement again and again, for starting values of a fit.
        """
        column = self.machine.axis_names.index(axis)
        about = self.machine.axes[column]
        dt = 1.0 / recording.rate_hz
        command, segments = self._held(recording, axis)
        measured = recording.values(about.driven)
        if restart_every is not None:
            segments = _shorter(segments, max(2, round(restart_every / dt)))
        kind = _KINDS[about.actuation]
        gain = float(about.inertia or 0.0) if about.actuation == "force" else about.gain
        low, high = about.range
        size = chain.axis_memory(dt)
        outs = np.full((2, len(thetas), len(command)), np.nan)

        def lane(i: int) -> None:
            chain.drive_axis(
                thetas[i], column * layout.AXIS_WIDTH, command, measured, segments, kind, gain, low, high, dt,
                max(3, round(START_WINDOW / dt)), round(SETTLE_WINDOW / dt), about.drives == "joint", size,
                outs[0, i], outs[1, i],
            )  # fmt: skip

        in_parallel(lane, len(thetas), len(command))
        return outs[0], outs[1]

    def _held(self, recording: Recording, axis: str) -> tuple[Array, npt.NDArray[np.int64]]:
        """:func:`held` of a command, remembered: a fit asks for it thousands of times."""
        known = self.commands.get((id(recording), axis))
        if known is None or known[0] is not recording:
            known = (recording, *held(recording.values(axis_signal(axis, "command")), recording.rate_hz))
            self.commands[id(recording), axis] = known
        return known[1], known[2]

    def joint(self, thetas: Array, cylinder: Array, measured: Array, axis: str, rate_hz: float) -> Array:
        """Cylinder (n,) or (lanes, n) → joint (lanes, n) through linkage and play."""
        if axis not in self.tables:
            raise SettingsError(f"axis {axis}", "no linkage", "geometry in machine.toml or a fitted actuator network")
        table, low, step = self.tables[axis]
        begin = self.machine.axis_names.index(axis) * layout.AXIS_WIDTH
        window = max(3, round(START_WINDOW * rate_hz))
        source = np.broadcast_to(cylinder, (len(thetas), cylinder.shape[-1]))
        out = np.empty(source.shape)

        def lane(i: int) -> None:
            chain.joint_axis(thetas[i], begin, source[i], measured, table, low, step, window, out[i])

        in_parallel(lane, len(thetas), source.shape[-1])
        return out

    def tip(self, thetas: Array, joints: Array) -> Array:
        """Joints (n, A) or (lanes, n, A) → end effector (lanes, n, 3)."""
        if self.chain is None:
            raise SettingsError(f"machine {self.machine.name}", "no URDF", "urdf and tip in machine.toml")
        c = self.chain
        source = np.broadcast_to(joints, (len(thetas), *joints.shape[-2:]))
        out = np.empty((len(thetas), source.shape[-2], 3))
        base = layout.base_place(self.axes)

        def lane(i: int) -> None:
            chain.tip(thetas[i], base, source[i], c.origins, c.axes, c.prismatic, c.order, c.end, out[i])

        in_parallel(lane, len(thetas), source.shape[-2])
        return out

    def tool(self, thetas: Array, ee: Array, measured: Array, rate_hz: float) -> Array:
        """End effector (n, 3) or (lanes, n, 3) → tool (lanes, n, 3); ``measured`` tool (n, 3) starts the swing."""
        source = np.broadcast_to(ee, (len(thetas), *ee.shape[-2:]))
        out = np.empty(source.shape)
        at = layout.tool_place(self.axes)
        window = max(5, round(START_WINDOW * rate_hz))

        def lane(i: int) -> None:
            chain.tool(thetas[i], at, source[i], measured, window, 1.0 / rate_hz, out[i])

        in_parallel(lane, len(thetas), source.shape[-2])
        return out


def compile_plant(plant: Plant) -> Model:
    """The arrays of a plant."""
    tables = {}
    for axis, linkage in plant.linkages.items():
        low, high = float(linkage.displacements[0]), float(linkage.displacements[-1])
        grid = np.linspace(low, high, 2048)
        tables[axis] = (linkage.joint(grid), low, (high - low) / 2047.0)
    kinematics = plant.machine.kinematics()
    return Model(plant.machine, plant.vector(), tables, None if kinematics is None else _chain(kinematics))


def _chain(kinematics: Kinematics) -> Chain:
    origins, axes, prismatic, order = [], [], [], []
    frame = np.eye(4)
    for joint in kinematics.chain:
        frame = frame @ joint.origin
        if joint.name in kinematics.actuated:
            origins.append(frame)
            axes.append(joint.axis)
            prismatic.append(joint.prismatic)
            order.append(kinematics.actuated.index(joint.name))
            frame = np.eye(4)
    return Chain(np.array(origins), np.array(axes), np.array(prismatic), np.array(order, dtype=np.int64), frame)


def held(command: Array, rate_hz: float) -> tuple[Array, npt.NDArray[np.int64]]:
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


def _shorter(segments: npt.NDArray[np.int64], length: int) -> npt.NDArray[np.int64]:
    """Every stretch cut into pieces of at most ``length`` samples."""
    cut = [(k, min(k + length, last)) for first, last in segments for k in range(first, last, length)]
    return np.array(cut, dtype=np.int64).reshape(-1, 2)


def measured_point(recording: Recording, point: str) -> Array:
    """``ee`` or ``tool`` as (n, 3); a row with any coordinate missing is all NaN."""
    values = np.column_stack([recording.values(signal) for signal in point_signals(point)])
    values[np.isnan(values).any(axis=1)] = np.nan
    return values


def measured_joints(recording: Recording, machine: Machine) -> Array:
    """All joints (n, A)."""
    return np.column_stack([recording.values(axis_signal(name, "joint")) for name in machine.axis_names])


_WORKERS = max(1, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1))
_pool: ThreadPoolExecutor | None = None
#: Fewer steps than this run faster on one core than handed to several.
SERIAL = 20_000


def in_parallel(lane: Callable[[int], None], count: int, samples: int) -> None:
    """Run ``lane(0) … lane(count − 1)`` of ``samples`` steps each; on all cores where that is worth it.

    The kernels release the interpreter lock; every worker takes a stretch of lanes.
    """
    global _pool
    workers = min(_WORKERS, count)
    if workers == 1 or count * samples < SERIAL:
        for i in range(count):
            lane(i)
        return
    if _pool is None:
        _pool = ThreadPoolExecutor(_WORKERS, thread_name_prefix="sysid-lane")

    def stretch(worker: int) -> None:
        for i in range(worker, count, workers):
            lane(i)

    list(_pool.map(stretch, range(workers)))
