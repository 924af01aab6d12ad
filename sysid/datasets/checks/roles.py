"""Checks of the roles: what fit, selection and test recordings each need, and what they lack.

The motion that a role needs is what the catalogue of effects needs (:class:`sysid.effects.Need`): the fit the whole amount,
selection and test half of it, as they are half as long. Where the recordings contain less, a role needs half of its share of
what there is: no assignment gives more to all roles. A quantity that the recordings hardly contain is not a shortage of a role,
but one of the recordings (``sysid datasets NAME --quality``).

What ``sysid gap`` needs before any search (recordings in each role, their length, stages measured at both ends) is stated only
here: ingest and ``sysid datasets NAME --quality`` report the first condition that is not met, and the gap workflow refuses the
dataset with the same words. Whether the motion excites an effect is another question (:mod:`sysid.gap.excitation`): a dataset
that meets these conditions can be searched.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.checks.figures import CheckContext
from sysid.datasets.checks.finding import Evidence, Finding
from sysid.datasets.chunked import Array, counted
from sysid.datasets.quality.motion import FEATURES, MotionTable, motion_table
from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Dataset, Recording, Role
from sysid.errors import ExcitationError
from sysid.machine import Machine
from sysid.names import listed
from sysid.signals import axis_signal, point_signals

ROLES: tuple[Role, ...] = ("fit", "select", "held_out")
#: Share of the whole duration for each role.
SHARES: dict[Role, float] = {"fit": 0.5, "select": 0.25, "held_out": 0.25}
#: Quantity of an axis → amount that the fit needs, weight of a shortage, and total from which the quantity counts.
#:
#: As in the catalogue of effects: 3 s in each direction (unequal speeds), 8 reversals (backlash), 2 s of small commands on each
#: side (dead-band); half of its 5 s of motion at large commands on each side. Without motion in a direction no effect is
#: observable; without reversals backlash, hysteresis and friction are not; without small or large commands dead-band or
#: saturation. What moves for less than the total is not moved; sizes have to be enough for one role at least.
_NEEDS = {
    "forward_s": (3.0, 1.0, 0.5),
    "backward_s": (3.0, 1.0, 0.5),
    "reversals": (8.0, 0.8, 2.0),
    "small_forward_s": (2.0, 0.7, 2.0),
    "small_backward_s": (2.0, 0.7, 2.0),
    "large_forward_s": (2.5, 0.7, 2.5),
    "large_backward_s": (2.5, 0.7, 2.5),
}
NEEDED, WEIGHTS, COUNTS = np.array([_NEEDS[feature] for feature in FEATURES]).T
#: Share of a role's part of a scarce quantity that is enough.
ENOUGH = 0.5
#: Steps in which weighted shortages are compared, rounded down. From the second step on a role lacks a quantity: it has less
#: than a third of what it needs of motion in a direction, less than a sixth of the reversals, no small or no large commands.
#: Smaller shortages are no reason to change roles, or to cut recordings.
LEVELS, LACKING = 3, 2


@dataclass(frozen=True)
class RoleNeeds:
    """Needs of some roles.

    Args:
        roles: R roles; ``shares``: of the duration, (R,), sum 1.
        amounts: (R, axes, features), zero where a quantity does not count.
    """

    roles: tuple[Role, ...]
    shares: Array
    amounts: Array

    @classmethod
    def of(cls, roles: Sequence[Role], totals: Array) -> RoleNeeds:
        """Needs of ``roles`` for recordings with these amounts, (axes, features)."""
        shares = np.array([SHARES[role] for role in roles])
        part = shares / shares.sum()
        whole = NEEDED * (shares / SHARES["fit"])[:, None, None]
        amounts = np.minimum(whole, ENOUGH * part[:, None, None] * totals)
        return cls(tuple(roles), part, np.where(totals >= COUNTS, amounts, 0.0))

    def shortages(self, amounts: Array) -> Array:
        """Relative shortage of every quantity, weighted: 0 none to 1 all of it, (…, R, axes, features)."""
        needed = np.where(self.amounts > 0.0, self.amounts, 1.0)
        missing = np.clip(1.0 - amounts / needed, 0.0, 1.0)
        return np.asarray(np.where(self.amounts > 0.0, missing * WEIGHTS, 0.0))


def levels(shortages: Array) -> npt.NDArray[np.int64]:
    """Shortages in whole steps of :data:`LEVELS`, rounded down."""
    return np.floor(LEVELS * shortages + 1e-9).astype(np.int64)


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
class UnmetNeed(Evidence):
    """A condition of the gap workflow that a dataset does not meet: what was found, what is needed, what to do."""

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


LackKind = Literal["motion", "direction", "reversals", "small", "large"]

#: What is done on the recordings of a role.
_DONE: dict[Role, str] = {"fit": "estimated", "select": "compared", "held_out": "validated"}
#: Below this share of its need, a role has nothing of a quantity; above, hardly anything.
_NOTHING = 0.1


@dataclass(frozen=True)
class Lack:
    """Axes that lack the same in the same roles.

    Args:
        kind: "motion" at all, one "direction", "reversals", or "small" or "large" commands.
        nowhere: no recording contains it, so that no other roles help.
        text: one sentence; ``record``: what to record.
    """

    axes: tuple[str, ...]
    roles: tuple[Role, ...]
    kind: LackKind
    nowhere: bool
    text: str
    record: str


def role_lacks(dataset: Dataset) -> tuple[Lack, ...]:
    """What the roles of ``dataset`` lack."""
    table = motion_table(dataset.of_kind("motion"), dataset.machine)
    return lacks_of(role_amounts(table, dataset.splits), table.axes, dataset.machine)


#: Kind of the findings about axes that do not move, the end of their keys.
STILL = "still"


def check_roles(data: CheckContext) -> Iterator[Finding]:
    """A notice for the axes that do not move in one of the roles, or in no recording; the rest is :func:`role_lacks`.

    Nothing is said where the stamps, or the ranges of all of these axes, are implausible themselves.
    """
    splits = data.dataset.splits
    motion = [recording for recording in data.motion if recording.name in splits]
    if not motion or data.time_scale != 1.0:
        return
    table = motion_table(motion, data.machine)
    for lack in lacks_of(role_amounts(table, splits), table.axes, data.machine):
        if lack.kind == "motion" and not data.doubtful.issuperset(lack.axes):
            keys = tuple(f"{axis}:{STILL}" for axis in lack.axes)
            yield Finding(keys, "notice", (Evidence(lack.text, "motion in the fit, selection and test recordings"),))


def role_amounts(table: MotionTable, splits: Mapping[str, Role]) -> Array:
    """Amounts of motion in each role, (roles, axes, features)."""
    by_role = ([name for name in table.recordings if splits.get(name) == role] for role in ROLES)
    return np.stack([table.of(names) for names in by_role])


def lacks_of(amounts: Array, axes: Sequence[str], machine: Machine) -> tuple[Lack, ...]:
    """What the roles lack.

    Args:
        amounts: (roles, axes, features).
    """
    totals = amounts.sum(axis=0)
    needs = RoleNeeds.of(ROLES, totals)
    shortages = needs.shortages(amounts)
    found: dict[tuple[LackKind, bool, bool, bool, tuple[Role, ...]], list[str]] = {}
    for place, axis in enumerate(axes):
        valve = machine.axis(axis).actuation == "velocity"
        if (totals[place, :2] < COUNTS[:2]).all():
            found.setdefault(("motion", True, True, valve, ROLES), []).append(axis)
            continue
        roles: dict[tuple[LackKind, bool], list[Role]] = {}
        for number, role in enumerate(ROLES):
            worst = int(np.argmax(shortages[number, place]))
            if levels(shortages[number, place, worst]) < LACKING:
                continue
            nothing = bool(amounts[number, place, worst] < _NOTHING * needs.amounts[number, place, worst])
            roles.setdefault((_kind(shortages[number, place], worst), nothing), []).append(role)
        for (kind, nothing), where in roles.items():
            found.setdefault((kind, False, nothing, valve, tuple(where)), []).append(axis)
    return tuple(
        Lack(
            tuple(names), roles, kind, nowhere, _text(kind, nowhere, nothing, valve, names, roles), _record(kind, names, roles)
        )
        for (kind, nowhere, nothing, valve, roles), names in found.items()
    )


def _kind(shortages: Array, worst: int) -> LackKind:
    if worst <= 1:
        return "motion" if (levels(shortages[:2]) >= LACKING).all() else "direction"
    return "reversals" if worst == FEATURES.index("reversals") else "small" if worst <= 4 else "large"


def _text(kind: LackKind, nowhere: bool, nothing: bool, valve: bool, axes: Sequence[str], roles: Sequence[Role]) -> str:
    names, one = listed(axes), len(axes) == 1
    if nowhere:
        return f"{names} {'moves' if one else 'move'} in no recording: an effect of {names} cannot be identified"
    hardly = "hardly any" if not nothing else "no"
    verbs = {
        "motion": ("does not move" if one else "do not move") if nothing else f"hardly {'moves' if one else 'move'}",
        "direction": f"{'moves' if one else 'move'} {'' if nothing else 'almost '}only in one direction",
        "reversals": f"{'has' if one else 'have'} {hardly} reversals",
        "small": f"{'has' if one else 'have'} {hardly} {'small commands' if valve else 'slow motion'} in one direction",
        "large": f"{'has' if one else 'have'} {hardly} {'large commands' if valve else 'fast motion'} in one direction",
    }
    effects = {
        "motion": "an effect",
        "direction": "a difference between the directions",
        "reversals": "backlash, hysteresis or friction",
        "small": "a dead-band" if valve else "friction at low speed",
        "large": "a saturation" if valve else "friction at high speed",
    }
    done = " or ".join(_DONE[role] for role in roles)
    where = listed([ROLE_NAMES[role] for role in roles])
    return f"{names} {verbs[kind]} in the {where} recordings: {effects[kind]} of {names} cannot be {done}"


def _record(kind: LackKind, axes: Sequence[str], roles: Sequence[Role]) -> str:
    """What to record, in recordings of their own that the roles then receive."""
    names, count = listed(axes), len(roles)
    amount = {
        "motion": f"over the range, {NEEDED[0]:g} s or more in each direction, with {NEEDED[2]:g} reversals",
        "direction": f"in both directions, {NEEDED[0]:g} s or more in each",
        "reversals": f"with {NEEDED[2]:g} reversals",
        "small": f"slowly, {NEEDED[3]:g} s or more in each direction",
        "large": f"at large commands, {NEEDED[5]:g} s or more in each direction",
    }[kind]
    where = "one more recording" if count == 1 else f"{('two', 'three')[count - 2]} more recordings"
    return f"Record {names} moving {amount}, in {where} of {MIN_ROLE_S:g} s or more."
