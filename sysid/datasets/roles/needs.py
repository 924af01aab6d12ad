"""What ``sysid gap`` needs of a dataset before any search: recordings in each role, their length, stages measured at both ends.

The only place of these conditions: ingest and ``sysid datasets NAME --quality`` report the first one that is not met, and the
gap workflow refuses the dataset with the same words. Whether the motion excites an effect is another question
(:mod:`sysid.gap.excitation`): a dataset that meets these conditions can be searched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.datasets.chunked import counted
from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Dataset, Recording
from sysid.datasets.roles.shortage import ROLES
from sysid.errors import ExcitationError
from sysid.machine import Machine
from sysid.signals import axis_signal, point_signals

#: Least recorded motion of a role, and of a block of a recording that is cut [s]. Predictive densities are compared over blocks
#: of about 5 s, one at least in a recording; a stroke in each direction, with its delays and lags, takes about as long.
MIN_ROLE_S = 4.0
#: Least number of samples in which both ends of a stage are measured.
MIN_SAMPLES = 50
#: Least number of static poses of a dataset without motion. A fifth of them is the test; the others give three coordinates
#: each, twice the number of parameters that a six-axis arm has in its frame, offsets, lengths and compliances.
MIN_POSES = 20
#: Role → its name in texts.
ROLE_NAMES = {"fit": "fit", "select": "selection", "held_out": "test"}


@dataclass(frozen=True)
class UnmetNeed:
    """A condition of the gap workflow that a dataset does not meet: what was found, what is needed, what to do."""

    found: str
    expected: str
    remedy: str

    @property
    def text(self) -> str:
        """For ingest and ``--quality``."""
        return f"sysid gap will need {self.expected}; there is {self.found}. {self.remedy}"


def least_cut_s(blocks: int, guard_s: float) -> float:
    """Least length of a recording that is cut into so many blocks [s]."""
    return blocks * (MIN_ROLE_S + guard_s)


def cut_advice(guard_s: float) -> str:
    """Lengths of recordings that give every role enough."""
    return (
        f"Record {least_cut_s(len(ROLES), guard_s):g} s or more in one recording, which is then cut for the roles, "
        f"or three recordings of {MIN_ROLE_S:g} s or more."
    )


def unmet_need(dataset: Dataset) -> UnmetNeed | None:
    """The first condition of the gap workflow that ``dataset`` does not meet."""
    stages = dict(_stages(dataset.machine))
    if is_pose_set(dataset):
        return _unmet_by_poses(dataset, stages["end effector"])
    motion = dataset.of_kind("motion")
    everything = (*motion, *dataset.of_kind("poses"))
    found = {name for name, signals in stages.items() if measured_together(everything, *signals)}
    if motion and not found:
        return UnmetNeed(
            "no stage that is measured at both its ends",
            f"commands and the motion that they cause, measured together for {MIN_SAMPLES} samples",
            f"Signals of a stage, for example: {' and '.join(next(iter(stages.values())))}.",
        )
    seconds = {role: sum(_seconds(r) for r in dataset.with_role(role)) for role in ROLES}
    if min(seconds.values()) < MIN_ROLE_S:
        listed = ", ".join(f"{seconds[role]:.1f} s for {ROLE_NAMES[role]}" for role in ROLES)
        expected = f"{MIN_ROLE_S:g} s of recorded motion or more in each role (fit, selection and test)"
        return UnmetNeed(listed, expected, _remedy(dataset, motion))
    for role in ROLES:
        here = dataset.with_role(role)
        if not any(measured_together(here, *stages[name]) for name in found):
            return UnmetNeed(
                f"no stage that is measured at both its ends in the {ROLE_NAMES[role]} recordings",
                f"{' and '.join(stages[min(found)])}, for example, in recordings of each role",
                f"`sysid datasets split {dataset.reference} --suggest` shows the roles.",
            )
    return None


def is_pose_set(dataset: Dataset) -> bool:
    """Whether the dataset has static poses and no motion."""
    return bool(dataset.of_kind("poses")) and not dataset.of_kind("motion")


def _unmet_by_poses(dataset: Dataset, signals: Sequence[str]) -> UnmetNeed | None:
    """The condition of static poses without motion: enough of them, with all joints and the end effector measured."""
    count = poses_together(dataset, *signals)
    if count >= MIN_POSES:
        return None
    missing = [s for s in signals if all(np.isnan(r.values(s)).all() for r in dataset.of_kind("poses"))]
    found = f"none with {' and '.join(missing)}" if missing else f"{count} of them"
    expected = f"{MIN_POSES} static poses or more with every joint and the end effector measured"
    remedy = "Record static poses over the whole work space, or add a recording of motion."
    return UnmetNeed(found, expected, remedy)


def check_needs(dataset: Dataset) -> None:
    """Refuse a dataset in which the gap workflow cannot search.

    Raises:
        ExcitationError: a condition is not met.
    """
    need = unmet_need(dataset)
    if need is not None:
        raise ExcitationError(dataset.reference, need.found, need.expected, need.remedy)


def measured_together(recordings: Sequence[Recording], *signals: str) -> bool:
    """Whether some recording contains all signals simultaneously for at least :data:`MIN_SAMPLES`."""
    return any(_together(recording, *signals) >= MIN_SAMPLES for recording in recordings)


def poses_together(dataset: Dataset, *signals: str) -> int:
    """Number of static poses in which all signals are measured, over all pose sets."""
    return sum(_together(r, *signals) for r in dataset.of_kind("poses"))


def _together(recording: Recording, *signals: str) -> int:
    """Number of samples in which all signals are measured."""
    columns = [recording.values(name) for name in signals]
    return counted(len(recording), lambda a, b: ~np.any([np.isnan(values[a:b]) for values in columns], axis=0))


def _stages(machine: Machine) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Stages that any simulation of the machine may have: name → the signals of their ends."""
    for axis in machine.axes:
        yield f"{axis.name} drive", (axis_signal(axis.name, "command"), axis.driven)
    for axis in machine.axes:
        if axis.drives == "cylinder":
            yield f"{axis.name} joint", (axis.driven, axis_signal(axis.name, "joint"))
    joints = [axis_signal(name, "joint") for name in machine.axis_names]
    yield "end effector", (*joints, *point_signals("ee"))
    yield "tool", (*point_signals("ee"), *point_signals("tool"))


def _seconds(recording: Recording) -> float:
    """Length of a recording, from its first sample to one after its last [s]."""
    return (len(recording) + 1) / recording.rate_hz


def _remedy(dataset: Dataset, motion: Sequence[Recording]) -> str:
    """What gives every role enough: other roles, if the recordings are long enough; else other recordings."""
    guard_s = Splits().guard_s
    if sum(_seconds(r) >= MIN_ROLE_S for r in motion) >= len(ROLES):
        return f"The recordings are long enough: `sysid datasets split {dataset.reference} --suggest` shows other roles."
    if any(_seconds(r) >= least_cut_s(len(ROLES), guard_s) and "#" not in r.name for r in motion):
        return (
            "The recordings are long enough: leave [splits] out of the recipe and ingest them again; a recording of "
            f"{least_cut_s(len(ROLES), guard_s):g} s or more is then cut into a block for each role."
        )
    return cut_advice(guard_s)
