"""One stage of the chain as a fitting problem: measured output, what a plant predicts for it, and its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Recording, Role
from sysid.effects.effect import Stage
from sysid.gap.drift import BIN
from sysid.machine import Axis
from sysid.plant import Model
from sysid.plant.force import ForceInputs, force_inputs, hold_of
from sysid.plant.model import measured_joints, measured_point
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]


class Problem(Protocol):
    """A stage driven by its measured input.

    Attributes:
        stage, target: where it sits; ``targets`` are the effect targets that belong to it.
        signals: names of the outputs, in the order of the last dimension of ``predict``.
        nuisances: effects whose parameters are free in every fit, since they would otherwise be absorbed by others.
    """

    @property
    def stage(self) -> Stage: ...

    @property
    def target(self) -> str: ...

    @property
    def targets(self) -> tuple[str, ...]: ...

    @property
    def signals(self) -> tuple[str, ...]: ...

    @property
    def nuisances(self) -> tuple[str, ...]: ...

    def predict(self, thetas: Array, recording: Recording) -> Array:
        """(lanes, N) → (lanes, n, len(signals))."""
        ...

    def measured(self, recording: Recording) -> Array:
        """(n, len(signals)), NaN where missing."""
        ...

    def rate(self, recording: Recording) -> float:
        """Rows of :meth:`measured` a second."""
        ...

    def rows(self, recording: Recording) -> npt.NDArray[np.int64]:
        """The recording's row of each row of :meth:`measured`."""
        ...


@dataclass(frozen=True)
class DriveProblem:
    """Command → what it drives, free-running over whole recordings."""

    model: Model
    axis: Axis
    stage: Stage = "command"
    nuisances: tuple[str, ...] = ("gain_error",)
    restart_every: float | None = None

    @property
    def target(self) -> str:
        return self.axis.name

    @property
    def targets(self) -> tuple[str, ...]:
        return (self.axis.name,)

    @property
    def signals(self) -> tuple[str, ...]:
        return (self.axis.driven,)

    def predict(self, thetas: Array, recording: Recording) -> Array:
        return self.model.drive(thetas, recording, self.axis.name, self.restart_every)[1][:, :, None]

    def measured(self, recording: Recording) -> Array:
        return recording.values(self.axis.driven)[:, None]

    def rate(self, recording: Recording) -> float:
        return recording.rate_hz

    def rows(self, recording: Recording) -> npt.NDArray[np.int64]:
        return np.arange(len(recording))

    def in_short_runs(self, seconds: float) -> DriveProblem:
        """The same problem restarted from the measurement every few seconds: a drift cannot trap a fit there."""
        return replace(self, restart_every=seconds)


@dataclass(frozen=True)
class ForceProblem:
    """Measured motion → force, on a force axis; ``inputs`` are the filtered recordings by name."""

    model: Model
    axis: Axis
    inputs: dict[str, tuple[Recording, ForceInputs]]
    stage: Stage = "force"
    nuisances: tuple[str, ...] = ()

    @property
    def target(self) -> str:
        return self.axis.name

    @property
    def targets(self) -> tuple[str, ...]:
        return (self.axis.name,)

    @property
    def signals(self) -> tuple[str, ...]:
        return (axis_signal(self.axis.name, "command"),)

    def predict(self, thetas: Array, recording: Recording) -> Array:
        return self._inputs(recording).model_force(self.model, thetas, self.axis.name)[:, :, None]

    def measured(self, recording: Recording) -> Array:
        return self._inputs(recording).force[:, None]

    def rate(self, recording: Recording) -> float:
        return recording.rate_hz / float(np.median(np.diff(self.rows(recording))))

    def rows(self, recording: Recording) -> npt.NDArray[np.int64]:
        return self.inputs[recording.name][1].rows

    def _inputs(self, recording: Recording) -> ForceInputs:
        """The filtered recording; a changed copy of a known one (with noise added) is filtered afresh on the same rows."""
        original, inputs = self.inputs[recording.name]
        return inputs if recording is original else force_inputs(recording, self.axis, rows=inputs.rows, hold=inputs.hold)


@dataclass(frozen=True)
class JointProblem:
    """Cylinder → joint through the linkage."""

    model: Model
    axis: Axis
    stage: Stage = "joint"
    nuisances: tuple[str, ...] = ()

    @property
    def target(self) -> str:
        return self.axis.name

    @property
    def targets(self) -> tuple[str, ...]:
        return (self.axis.name,)

    @property
    def signals(self) -> tuple[str, ...]:
        return (axis_signal(self.axis.name, "joint"),)

    def predict(self, thetas: Array, recording: Recording) -> Array:
        cylinder = recording.values(axis_signal(self.axis.name, "cylinder"))
        return self.model.joint(thetas, cylinder, self.measured(recording)[:, 0], self.axis.name, recording.rate_hz)[:, :, None]

    def measured(self, recording: Recording) -> Array:
        return recording.values(axis_signal(self.axis.name, "joint"))[:, None]

    def rate(self, recording: Recording) -> float:
        return recording.rate_hz

    def rows(self, recording: Recording) -> npt.NDArray[np.int64]:
        return np.arange(len(recording))


@dataclass(frozen=True)
class TipProblem:
    """Joints → end effector through the kinematics."""

    model: Model
    stage: Stage = "end_effector"
    target: str = "ee"
    signals: tuple[str, ...] = point_signals("ee")
    nuisances: tuple[str, ...] = ()

    @property
    def targets(self) -> tuple[str, ...]:
        return (*self.model.machine.axis_names, "base")

    def predict(self, thetas: Array, recording: Recording) -> Array:
        return self.model.tip(thetas, measured_joints(recording, self.model.machine))

    def measured(self, recording: Recording) -> Array:
        return measured_point(recording, "ee")

    def rate(self, recording: Recording) -> float:
        return recording.rate_hz if recording.kind == "motion" else 1.0 / BIN  # poses are independent: one bin each

    def rows(self, recording: Recording) -> npt.NDArray[np.int64]:
        return np.arange(len(recording))


@dataclass(frozen=True)
class ToolProblem:
    """End effector → hanging tool."""

    model: Model
    stage: Stage = "tool"
    target: str = "tool"
    targets: tuple[str, ...] = ("tool",)
    signals: tuple[str, ...] = point_signals("tool")
    nuisances: tuple[str, ...] = ()

    def predict(self, thetas: Array, recording: Recording) -> Array:
        return self.model.tool(thetas, measured_point(recording, "ee"), self.measured(recording), recording.rate_hz)

    def measured(self, recording: Recording) -> Array:
        return measured_point(recording, "tool")

    def rate(self, recording: Recording) -> float:
        return recording.rate_hz

    def rows(self, recording: Recording) -> npt.NDArray[np.int64]:
        return np.arange(len(recording))


@dataclass(frozen=True)
class Split:
    """Recordings by role, as the gap workflow uses them."""

    fit: tuple[Recording, ...]
    select: tuple[Recording, ...]
    held_out: tuple[Recording, ...]

    @property
    def seen(self) -> tuple[Recording, ...]:
        """What the last fit may use: all but the held-out ones."""
        return (*self.fit, *self.select)


def split_of(dataset: Dataset) -> Split:
    """Motion recordings by the roles that the dataset version froze."""
    return Split(*(dataset.with_role(role) for role in _ROLES))


_ROLES: tuple[Role, ...] = ("fit", "select", "held_out")


def pose_split(dataset: Dataset) -> Split:
    """Static poses by role: as frozen in the dataset; a set with one role only is cut into contiguous blocks (60/20/20 %)."""
    by_role = [dataset.with_role(role, kind="poses") for role in _ROLES]
    if sum(bool(part) for part in by_role) > 1:
        return Split(*by_role)
    parts: list[list[Recording]] = [[], [], []]
    for recording in dataset.of_kind("poses"):
        cuts = [0, round(0.6 * len(recording)), round(0.8 * len(recording)), len(recording)]
        for k, part in enumerate(parts):
            rows = recording.table.iloc[cuts[k] : cuts[k + 1]].reset_index(drop=True)
            part.append(replace(recording, name=f"{recording.name}#{k + 1}", table=rows))
    return Split(*(tuple(part) for part in parts))


def problems_of(model: Model, dataset: Dataset) -> list[Problem]:
    """The stages that this dataset measures at both ends, in the order of the chain."""
    split = split_of(dataset)
    motion = (*split.seen, *split.held_out)
    problems: list[Problem] = []
    for axis in model.machine.axes:
        if not _measured(motion, axis_signal(axis.name, "command"), axis.driven):
            continue
        if axis.actuation == "force":
            hold = hold_of(split.seen, axis)
            inputs = {r.name: (r, force_inputs(r, axis, hold=hold)) for r in motion}
            problems.append(ForceProblem(model, axis, inputs))
        else:
            nuisances = ("gain_error", "input_delay") if axis.actuation == "velocity" else ("input_delay",)
            problems.append(DriveProblem(model, axis, nuisances=nuisances))
    for axis in model.machine.axes:
        if (
            axis.drives == "cylinder"
            and axis.name in model.tables
            and _measured(motion, axis.driven, axis_signal(axis.name, "joint"))
        ):
            problems.append(JointProblem(model, axis))
    joints = [axis_signal(name, "joint") for name in model.machine.axis_names]
    if model.chain is not None and _measured((*motion, *dataset.of_kind("poses")), *joints, *point_signals("ee")):
        problems.append(TipProblem(model))
    if model.machine.tool is not None and _measured(motion, *point_signals("ee"), *point_signals("tool")):
        problems.append(ToolProblem(model))
    return problems


def _measured(recordings: Sequence[Recording], *signals: str) -> bool:
    """Whether some recording has all signals at the same time for at least fifty samples."""
    for recording in recordings:
        there = np.ones(len(recording), dtype=bool)
        for name in signals:
            there &= ~np.isnan(recording.values(name))
        if there.sum() >= 50:
            return True
    return False
