"""Suggested roles for a stored dataset version, beside the present ones: ``sysid datasets split NAME --suggest``."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from glob import escape
from typing import Any

import numpy as np

from sysid.config import parse_settings, toml_values
from sysid.datasets.checks.roles import ROLES, Lack, lacks_of, role_amounts
from sysid.datasets.chunked import Array
from sysid.datasets.quality.evidence import repeats_of
from sysid.datasets.quality.motion import FEATURES, AxisMotion, by_axis, motion_table
from sysid.datasets.quality.use import scales_of
from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Dataset, Recording, Role
from sysid.datasets.splits import Measured, SplitBlock, assignment_of, block_pattern, can_be_cut
from sysid.names import uncut_name
from sysid.quoting import toml_key, toml_value

#: Share of the end of a recording that is held out where it is cut.
_HELD_OUT = 0.25
#: Largest number of recordings whose commands are compared with each other for repeats.
_COMPARED = 40


@dataclass(frozen=True)
class RolesMotion:
    """Roles of recordings, and what is in each role.

    Args:
        roles: recording → role.
        seconds: of each role [s].
        motion: role → axis → its motion.
        lacks: what the roles lack.
    """

    roles: Mapping[str, Role]
    seconds: Mapping[Role, float]
    motion: Mapping[Role, Mapping[str, AxisMotion]]
    lacks: tuple[Lack, ...]

    def to_json(self) -> dict[str, Any]:
        return {
            "roles": dict(self.roles),
            "seconds": dict(self.seconds),
            "motion": {role: {axis: asdict(value) for axis, value in axes.items()} for role, axes in self.motion.items()},
            "lacks": [asdict(lack) for lack in self.lacks],
        }


@dataclass(frozen=True)
class SplitSuggestion:
    """Present and suggested roles.

    Args:
        present, suggested: the suggestion has no role for recordings in ``cut``.
        cut: recordings to be cut into blocks of all roles, by ingesting the logs again.
        named: recordings whose roles the recipe names: they stay.
        seconds: recording → its length [s].
        repeats: (test recording, fit or selection recording) of the same commands, with the suggestion.
    """

    dataset: str
    present: RolesMotion
    suggested: RolesMotion
    cut: tuple[str, ...]
    named: tuple[str, ...]
    seconds: Mapping[str, float]
    repeats: tuple[tuple[str, str], ...]

    @property
    def changed(self) -> dict[str, Role]:
        """Recording → new role, for those that are not cut."""
        return {name: role for name, role in self.suggested.roles.items() if role != self.present.roles.get(name)}

    @property
    def better(self) -> bool:
        """Whether the suggestion differs from the present roles."""
        return bool(self.changed or self.cut)

    def command(self, location: str) -> str:
        """The command that applies the suggestion; empty where recordings have to be cut, or nothing changes."""
        if self.cut or not self.changed:
            return ""
        options = {"fit": "--fit", "select": "--select", "held_out": "--held-out"}
        words = ["sysid", "--workspace", location, "datasets", "split", self.dataset]
        for name, role in self.changed.items():
            words += [options[role], escape(name)]
        return shlex.join(words)

    @property
    def recipe(self) -> str:
        """Lines of the recipe that give these roles at the next ingest; empty where they cannot be written there."""
        roles = self.suggested.roles
        blocks = {name for name in roles if uncut_name(name) != name}
        if not self.better or any(name in self.changed for name in blocks):
            return ""
        lines = ["[splits]"]
        for role in ROLES:
            names = [escape(name) for name, given in roles.items() if given == role and name not in blocks]
            if names:
                lines.append(f"{role} = {toml_value(names)}")
        last = [*self.cut, *dict.fromkeys(uncut_name(name) for name in blocks if uncut_name(name) not in self.named)]
        if last:
            shares = ", ".join(f"{toml_key(name)} = {_HELD_OUT:g}" for name in last)
            lines.append(f"held_out_last = {{ {shares} }}")
        return "\n".join(lines)

    def to_json(self, location: str) -> dict[str, Any]:
        suggested = self.suggested.to_json()
        return {
            "schema": 1,
            "dataset": self.dataset,
            "better": self.better,
            "named_in_recipe": list(self.named),
            "present": self.present.to_json(),
            "suggested": {"roles": suggested.pop("roles"), "cut": list(self.cut), **suggested},
            "repeats": [{"test": test, "repeats": other} for test, other in self.repeats],
            "command": self.command(location),
            "recipe": self.recipe,
        }


def suggest_split(dataset: Dataset, recipes: Sequence[Splits] = ()) -> SplitSuggestion:
    """The best roles of the recordings of ``dataset``; its present ones where no others have smaller shortages of motion.

    Args:
        recipes: splits of the recipes that the version was made with: roles that they name stay.
    """
    motion = [r for r in dataset.of_kind("motion") if r.name in dataset.splits]
    table = motion_table(motion, dataset.machine)
    named = tuple(r.name for r in motion if any(_names(splits, r.name) for splits in recipes))
    free = [r for r in motion if r.name not in named]
    fixed = {dataset.splits[name] for name in named}
    mine = {dataset.splits[r.name] for r in free}
    roles = [role for role in ROLES if role in mine or role not in fixed]
    suggested, cut = dict(dataset.splits), tuple[str, ...]()
    nothing = np.zeros((len(ROLES), len(table.axes), len(FEATURES)))
    extra, extra_s = nothing, [0.0] * len(ROLES)
    if free and len(roles) > 1:
        guard_s = recipes[-1].guard_s if recipes else Splits().guard_s
        patterns = [_pattern(r, guard_s) if len(roles) == len(ROLES) else () for r in free]
        problem = assignment_of(free, roles, patterns, guard_s, table)
        present = np.array([roles.index(dataset.splits[r.name]) for r in free])
        choice = problem.best(present)
        rows = np.flatnonzero(choice == len(roles))
        cut = tuple(free[row].name for row in rows)
        suggested |= {r.name: roles[k] for r, k in zip(free, choice, strict=True) if k < len(roles)}
        suggested = {name: role for name, role in suggested.items() if name not in cut}
        if len(rows):
            extra, extra_s = problem.amounts[rows, -1].sum(axis=0), problem.seconds[rows, -1].sum(axis=0).tolist()
    seconds = {r.name: len(r) / r.rate_hz for r in motion}

    def described(splits: Mapping[str, Role], extra: Array, extra_s: Sequence[float]) -> RolesMotion:
        """These roles, with more amounts of motion (roles, axes, features) and seconds (roles,) from parts of recordings."""
        amounts = role_amounts(table, splits) + extra
        lengths = [sum(value for name, value in seconds.items() if splits.get(name) == role) for role in ROLES]
        return RolesMotion(
            {r.name: splits[r.name] for r in motion if r.name in splits},
            {role: length + more for role, length, more in zip(ROLES, lengths, extra_s, strict=True)},
            {role: by_axis(own, table.axes) for role, own in zip(ROLES, amounts, strict=True)},
            lacks_of(amounts, table.axes, dataset.machine),
        )

    return SplitSuggestion(
        dataset.reference,
        described(dataset.splits, nothing, [0] * len(ROLES)),
        described(suggested, extra, extra_s),
        cut,
        named,
        seconds,
        _repeats(motion, dataset, suggested),
    )


def _names(splits: Splits, name: str) -> bool:
    """Whether the recipe names a recording, or the one that it was cut from."""
    whole = uncut_name(name)
    patterns = (*splits.fit, *splits.select, *splits.held_out)
    return whole in splits.held_out_last or any(fnmatchcase(whole, pattern) for pattern in patterns)


def _pattern(recording: Recording, guard_s: float) -> tuple[SplitBlock, ...]:
    """Blocks of a recording, for all roles; none for what is a block already, or too short."""
    blocks = block_pattern(list(ROLES), Measured.of(recording).seconds)
    whole = uncut_name(recording.name) == recording.name
    return blocks if whole and can_be_cut(recording, blocks, guard_s) else ()


def _repeats(motion: Sequence[Recording], dataset: Dataset, roles: Mapping[str, Role]) -> tuple[tuple[str, str], ...]:
    """Test recordings with the commands of one of fit or selection; none where there are many recordings to compare."""
    whole = [r for r in motion if r.name in roles]
    if len(whole) > _COMPARED:
        return ()
    found: dict[str, str] = {}
    for pair in repeats_of(whole, scales_of(whole, dataset.machine)):
        for one, other in ((pair.first, pair.second), (pair.second, pair.first)):
            if roles[one] == "held_out" and roles[other] != "held_out":
                found.setdefault(one, other)
    return tuple(found.items())


def recipe_splits(text: str, where: object) -> Splits:
    """The ``[splits]`` of the text of a recipe."""
    return parse_settings(toml_values(text, where).get("splits", {}), Splits, f"{where}: splits")
