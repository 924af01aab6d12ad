"""What a role lacks, in words: axes that do not move, reverse or reach small and large commands, and what to record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Role
from sysid.datasets.roles.motion import FEATURES, MotionTable, motion_table
from sysid.datasets.roles.needs import MIN_ROLE_S, ROLE_NAMES
from sysid.datasets.roles.shortage import COUNTS, LACKING, NEEDED, ROLES, RoleNeeds, levels
from sysid.machine import Machine
from sysid.names import listed

Array = npt.NDArray[np.float64]
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
