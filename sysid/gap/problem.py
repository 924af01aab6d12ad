"""One stage of the chain as a fitting problem: its measured output and the prediction of a plant for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.checks.roles import MIN_POSES, ROLES, is_pose_set, measured_together, poses_together
from sysid.datasets.quality.motion import MOVED_SHARE, travel_of
from sysid.datasets.recording import Dataset, Recording
from sysid.effects.effect import Stage
from sysid.errors import ExcitationError
from sysid.gap.arm.forces import ArmForces
from sysid.gap.arm.pose_folds import pose_roles
from sysid.gap.drift import BIN
from sysid.gap.stage_kind import DRIVES, FORCE, JOINT, LINKS, POSES, POSITION, TIP, TOOL, StageKind
from sysid.machine import Axis
from sysid.plant import Model
from sysid.plant.force import ForceFilter, ForceInputs, force_inputs
from sysid.plant.force_band import force_filter
from sysid.plant.force_delay import force_delay
from sysid.plant.model import measured_point
from sysid.plant.servo_series import servo_force
from sysid.signals import axis_signal, point_signals, split_signal

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

#: Length of the short runs from which a drive fit takes its starting values [s].
SHORT_RUN = 5.0


def _unchanged(recording: Recording) -> Recording:
    return recording


@dataclass(frozen=True)
class Problem:
    """A stage driven by its measured input.

    Args:
        kind, target: its place in the chain; ``targets``: targets of the effects that belong to it.
        signals: names of the d outputs.
        predict: (lanes, N) parameters and a recording → (lanes, n, d).
        measured: recording → (n, d), NaN where missing.
        rows: recording → indices of the n measured rows.
        again: (model, recordings, filter of a force) → the same stage of another model; of a force, for these recordings, less
            those that do not determine it.
        short: the same problem restarted from the measurement every few seconds, where drift could lead to a local optimum.
        poses: static poses excite it too, each an independent measurement.
        only: names of the recordings of motion in which it can be compared; None: all.
        force_filter: of a force stage.
        force: recording → force of the drive inside the stage, (n,) [N·m or N], where the plant describes one.
        carried: axes whose links it moves; the errors of their masses show in it.
        inputs: measured signals that drive it; ``estimated``: recording → the recording with estimates of these;
            ``by_estimates``: the same stage for such recordings.
    """

    kind: StageKind
    target: str
    targets: tuple[str, ...]
    signals: tuple[str, ...]
    predict: Callable[[Array, Recording], Array]
    measured: Callable[[Recording], Array]
    rows: Callable[[Recording], Rows]
    again: Callable[[Model, Sequence[Recording], ForceFilter], Problem]
    short: Problem | None = None
    poses: bool = False
    only: frozenset[str] | None = None
    force_filter: ForceFilter | None = None
    force: Callable[[Recording], Array] | None = None
    carried: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    estimated: Callable[[Recording], Recording] = _unchanged
    by_estimates: Problem | None = None

    @property
    def stage(self) -> Stage:
        """Name of its place in the chain, for results."""
        return self.kind.stages[0]

    def residual(self, theta: Array, recording: Recording) -> Array:
        """Measured less predicted output, (n, d), NaN where missing."""
        return np.asarray(self.measured(recording) - self.predict(theta[None], recording)[0])

    def rate(self, recording: Recording) -> float:
        """Measured rows per second; each static pose has its own bin."""
        if recording.kind == "poses":
            return 1.0 / BIN
        rows = self.rows(recording)
        return recording.rate_hz / float(np.median(np.diff(rows))) if len(rows) > 1 else recording.rate_hz


def drive_problem(model: Model, axis: Axis, restart_every: float | None = None) -> Problem:
    """Command → driven signal, in free runs over whole recordings."""

    def predict(thetas: Array, recording: Recording) -> Array:
        return model.drive(thetas, recording, axis.name, restart_every)[:, :, None]

    kind = DRIVES[axis.actuation]
    targets = (axis.name, "machine") if _shares_pump(model, axis) else (axis.name,)
    return Problem(
        kind,
        axis.name,
        targets if kind.integrates else (*targets, axis.driven),  # a servo's position is its setpoint plus the sensor's bias
        (axis.driven,),
        predict,
        lambda recording: recording.values(axis.driven)[:, None],
        _every_row,
        lambda other, *_: drive_problem(other, other.machine.axis(axis.name)),
        force=(lambda recording: servo_force(axis, recording)) if "force" in kind.stages else None,
        carried=model.carried(axis.name) if model.links_move else (),
        short=drive_problem(model, axis, SHORT_RUN) if kind.integrates and restart_every is None else None,
    )


def speed_problem(model: Model, axis: Axis) -> Problem:
    """Command → rate of the driven signal: a further output of the command stage, which is reported and not fitted.

    The errors of both are one disturbance of the flow, once as it is and once integrated: as two outputs with disturbances of
    their own they would count the same evidence twice.
    """
    speed = axis_signal(axis.name, "speed")
    return Problem(
        POSITION,  # also that of a speed drive: its rate is no integral of the command
        axis.name,
        (axis.name,),
        (speed,),
        lambda thetas, recording: model.speed(thetas, recording, axis.name)[:, :, None],
        lambda recording: recording.values(speed)[:, None],
        _every_row,
        lambda other, *_: speed_problem(other, other.machine.axis(axis.name)),
    )


def force_problem(model: Model, axis: Axis, recordings: Sequence[Recording], settings: ForceFilter | None = None) -> Problem:
    """Measured motion → force on a force axis, on the filtered rows of each of ``recordings``."""
    known = {r.name: (r, force_inputs(r, axis, settings)) for r in recordings}

    def inputs_of(recording: Recording) -> ForceInputs:
        """A changed copy of a known recording (with noise added) is filtered on the same rows."""
        original, inputs = known[recording.name]
        return inputs if recording is original else force_inputs(recording, axis, settings, inputs.rows)

    def again(other: Model, given: Sequence[Recording], by: ForceFilter) -> Problem:
        there = other.machine.axis(axis.name)
        return force_problem(other, there, _determining(given, [there], by), by)

    return Problem(
        FORCE,
        axis.name,
        (axis.name,),
        (axis_signal(axis.name, "command"),),
        lambda thetas, recording: inputs_of(recording).model_force(model, thetas, axis.name)[:, :, None],
        lambda recording: inputs_of(recording).force[:, None],
        lambda recording: known[recording.name][1].rows,
        again,
        only=frozenset(known),
        force_filter=settings or ForceFilter(),
    )


def links_problem(model: Model, axes: Sequence[Axis], recordings: Sequence[Recording]) -> Problem:
    """Measured motion → forces of all force axes of an arm at once, without the friction of the joints.

    Its effects are those of the links, which act on several axes.
    """
    forces = ArmForces(model, axes, recordings)

    def again(other: Model, given: Sequence[Recording], by: ForceFilter) -> Problem:
        there = [other.machine.axis(axis.name) for axis in axes]
        return links_problem(other, there, _determining(given, there, by))

    return Problem(
        LINKS,
        "arm",
        ("tool", *(axis.name for axis in axes)),
        tuple(axis_signal(axis.name, "command") for axis in axes),
        forces.predicted,
        forces.measured,
        forces.rows,
        again,
        only=forces.names,
    )


def force_determined(recording: Recording, axis: Axis, least_travel: float, settings: ForceFilter) -> bool:
    """Whether the motion of a force axis in a recording determines its force: it is measured, and moves by more than noise."""
    if travel_of(recording.values(axis.driven)) < least_travel:
        return False
    try:
        force_inputs(recording, axis, settings)
    except ExcitationError:
        return False
    return True


def for_recordings(problem: Problem, model: Model, recordings: Sequence[Recording]) -> Problem:
    """The same stage for recordings that are not among those it was made for: a force stage holds the filtered motion of each.

    The filter is that of ``problem``. Recordings that do not determine the force are not among those in which it is compared.
    """
    return problem if problem.only is None else problem.again(model, recordings, problem.force_filter or ForceFilter())


def _determining(recordings: Sequence[Recording], axes: Sequence[Axis], settings: ForceFilter) -> list[Recording]:
    """The recordings of motion that determine the forces of all axes."""
    return [r for r in recordings if r.kind == "motion" and all(force_determined(r, axis, 0.0, settings) for axis in axes)]


def _force_problems(model: Model, axis: Axis, split: Split) -> list[Problem]:
    """The force stage of an axis, if recordings of each role determine it; its filter is that of the seen recordings."""
    least, settings = _force_comparison(model, axis, split)
    moving = Split(*(tuple(r for r in part if force_determined(r, axis, least, settings)) for part in split.roles))
    if not any(moving.roles) or not all(there for there, role in zip(moving.roles, split.roles, strict=True) if role):
        return []
    if model.rigid is None:
        settings = replace(settings, delay=force_delay(moving.seen, axis, settings))
    return [force_problem(model, axis, (*moving.seen, *moving.held_out), settings)]


def why_no_force(model: Model, axis: Axis, split: Split) -> ExcitationError | None:
    """What the first recording lacks that does not determine the force of an axis; None where all do."""
    least, settings = _force_comparison(model, axis, split)
    for recording in (*split.seen, *split.held_out):
        if travel_of(recording.values(axis.driven)) < least:
            return ExcitationError(f"{recording.name}: {axis.name}", "the axis hardly moves", "motion in both directions")
        try:
            force_inputs(recording, axis, settings)
        except ExcitationError as error:
            return error
    return None


def _force_comparison(model: Model, axis: Axis, split: Split) -> tuple[float, ForceFilter]:
    """Least travel of the axis in a recording, and the filter of its force."""
    motion = (*split.seen, *split.held_out)
    least = MOVED_SHARE * travel_of(np.concatenate([r.values(axis.driven) for r in motion]))
    if model.rigid is not None:  # the force on an axis of an arm is not a function of its own motion
        return least, ForceFilter()
    return least, force_filter([r for r in split.seen if travel_of(r.values(axis.driven)) >= least], axis)


def _links_problems(model: Model, forces: Sequence[Problem], split: Split) -> list[Problem]:
    """The links stage of an arm, if recordings of each role determine the forces of all tested axes."""
    tested = [p.only for p in forces if p.only is not None]
    names = frozenset.intersection(*tested) if tested else frozenset[str]()
    roles = [[r for r in role if r.name in names] for role in split.roles]
    if not names or not all(there for there, role in zip(roles, split.roles, strict=True) if role):
        return []
    axes = [model.machine.axis(p.target) for p in forces]
    return [links_problem(model, axes, [r for role in roles for r in role])]


def joint_problem(model: Model, axis: Axis) -> Problem:
    """Cylinder → joint through the linkage."""
    joint = axis_signal(axis.name, "joint")

    def predict(thetas: Array, recording: Recording) -> Array:
        return model.joint(thetas, recording, axis.name)[:, :, None]

    targets = (
        axis.name,
        axis_signal(axis.name, "cylinder"),
        joint,
        *other_clocks(model, axis_signal(axis.name, "cylinder"), joint),
    )
    return Problem(
        JOINT,
        axis.name,
        targets,
        (joint,),
        predict,
        lambda recording: recording.values(joint)[:, None],
        _every_row,
        lambda other, *_: joint_problem(other, other.machine.axis(axis.name)),
        inputs=(axis_signal(axis.name, "cylinder"),),
    )


def tip_problem(model: Model, kind: StageKind = TIP) -> Problem:
    """Joints → end effector through the kinematics; ``kind``: that of a dataset without motion is ``POSES``."""
    joints = [axis_signal(name, "joint") for name in model.machine.axis_names]
    return Problem(
        kind,
        "ee",
        (*model.machine.axis_names, "base", "ee", *joints, *other_clocks(model, *joints, *point_signals("ee"))),
        point_signals("ee"),
        model.tip,
        lambda recording: measured_point(recording, "ee"),
        _every_row,
        lambda other, *_: tip_problem(other, kind),
        poses=True,
        inputs=tuple(joints),
    )


def tool_problem(model: Model) -> Problem:
    """End effector → hanging tool; a plant without sway predicts tool = ee (contract)."""
    return Problem(
        TOOL,
        "tool",
        ("tool", *other_clocks(model, *point_signals("ee"), *point_signals("tool"))),
        point_signals("tool"),
        model.tool,
        lambda recording: measured_point(recording, "tool"),
        _every_row,
        lambda other, *_: tool_problem(other),
        inputs=point_signals("ee"),
    )


def _shares_pump(model: Model, axis: Axis) -> bool:
    """Whether another axis is fed by the same pump."""
    return axis.actuation == "velocity" and sum(a.actuation == "velocity" for a in model.machine.axes) > 1


def other_clocks(model: Model, *signals: str) -> tuple[str, ...]:
    """Streams that contain some but not all of these signals: an error of one clock for all of them is not observable.

    The stream of the commands is the reference.
    """
    found = []
    for stream, contained in model.streams.items():
        commands = any(split_signal(signal)[1] == "command" for signal in contained)
        if not commands and 0 < sum(signal in contained for signal in signals) < len(signals):
            found.append(stream)
    return tuple(found)


def _every_row(recording: Recording) -> Rows:
    return np.arange(len(recording))


@dataclass(frozen=True)
class Split:
    """Recordings by role, as the gap workflow uses them."""

    fit: tuple[Recording, ...]
    select: tuple[Recording, ...]
    held_out: tuple[Recording, ...]

    @property
    def roles(self) -> tuple[tuple[Recording, ...], ...]:
        """Fit, selection and held-out recordings."""
        return self.fit, self.select, self.held_out

    @property
    def seen(self) -> tuple[Recording, ...]:
        """Fit and selection recordings: all but the held-out ones."""
        return (*self.fit, *self.select)


def split_of(dataset: Dataset) -> Split:
    """Motion recordings by the roles of the dataset version."""
    return Split(*(dataset.with_role(role) for role in ROLES))


def pose_split(dataset: Dataset) -> Split:
    """Static poses by role: as in the dataset; a set with one role only is cut into contiguous blocks (60/20/20 %).

    Without motion beside them: see :mod:`sysid.gap.arm.pose_folds`.
    """
    if is_pose_set(dataset):
        return Split(*pose_roles(dataset).values())
    by_role = [dataset.with_role(role, kind="poses") for role in ROLES]
    if sum(bool(part) for part in by_role) > 1:
        return Split(*by_role)
    parts: list[list[Recording]] = [[], [], []]
    for recording in dataset.of_kind("poses"):
        cuts = [0, round(0.6 * len(recording)), round(0.8 * len(recording)), len(recording)]
        for k, part in enumerate(parts):
            rows = recording.table.iloc[cuts[k] : cuts[k + 1]].reset_index(drop=True)
            part.append(replace(recording, name=f"{recording.name}#{k + 1}", table=rows))
    return Split(*(tuple(part) for part in parts))


def all_joints(model: Model, recordings: Sequence[Recording]) -> bool:
    """Whether the joints of all axes are measured together, which the torques of links need."""
    return measured_together(recordings, *(axis_signal(name, "joint") for name in model.machine.axis_names))


def problems_of(model: Model, dataset: Dataset) -> list[Problem]:
    """The stages that this dataset measures at both ends, in the order of the chain."""
    split = split_of(dataset)
    motion = (*split.seen, *split.held_out)
    problems: list[Problem] = []
    for axis in model.machine.axes:
        moved_by_others = axis.actuation == "force" and model.rigid is not None
        if (moved_by_others or model.links_move) and not all_joints(model, motion):
            continue
        if not measured_together(motion, axis_signal(axis.name, "command"), axis.driven):
            continue
        if axis.actuation == "force":
            problems += _force_problems(model, axis, split)
        else:
            problems.append(drive_problem(model, axis))
    if model.rigid is not None:
        problems = [*_links_problems(model, [p for p in problems if p.kind.is_force], split), *problems]
    for axis in model.machine.axes:
        joint = axis_signal(axis.name, "joint")
        if axis.drives == "cylinder" and axis.name in model.linked and measured_together(motion, axis.driven, joint):
            problems.append(joint_problem(model, axis))
    joints = [axis_signal(name, "joint") for name in model.machine.axis_names]
    measured = (*joints, *point_signals("ee"))
    enough = poses_together(dataset, *measured) >= MIN_POSES if is_pose_set(dataset) else False
    if model.posed and (enough or measured_together((*motion, *dataset.of_kind("poses")), *measured)):
        problems.append(tip_problem(model, POSES if is_pose_set(dataset) else TIP))
    if model.posed and measured_together(motion, *point_signals("ee"), *point_signals("tool")):
        problems.append(tool_problem(model))
    return problems
