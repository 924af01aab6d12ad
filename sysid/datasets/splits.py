"""Roles of recordings (fit, selection, held-out): as a whole or in contiguous blocks with a guard, never by sample."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from sysid.datasets.checks.roles import MIN_ROLE_S, ROLES, RoleNeeds, cut_advice, least_cut_s
from sysid.datasets.chunked import Array, Rows, copied, deviation, known, masked, stretches
from sysid.datasets.quality.motion import MotionTable, motion_table
from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Recording, Role
from sysid.datasets.split_assignment import Assignment
from sysid.errors import InputError, SettingsError, nearest
from sysid.machine import Machine
from sysid.scratch import computed, filled, pieces

#: From this length on a recording is cut into two pairs of fit and select blocks, so that both contain early and late
#: conditions [s].
LONG_S = 60.0


#: Nothing is measured for longer than this [s]: a pause, at which a recording that is cut is cut as well.
PAUSE_S = 1.0
#: Rows of a recording by which candidates for a copy are found.
_COMPARED = 64


@dataclass(frozen=True)
class Measured:
    """The rows of a recording without its pauses, counted through: stretches of rows ``first`` … ``last`` − 1, each (k,)."""

    first: Rows
    last: Rows
    rate_hz: float

    @classmethod
    def of(cls, recording: Recording) -> Measured:
        """Computed once for a recording."""
        if "measured rows" not in recording.derived:
            columns = [recording.values(signal) for signal in recording.signals]
            there = masked(len(recording), lambda a, b: ~np.all([np.isnan(values[a:b]) for values in columns], axis=0))
            first, last = stretches(there) if columns else (np.empty(0, np.intp), np.empty(0, np.intp))
            apart = first[1:] - last[:-1] > PAUSE_S * recording.rate_hz
            keep = np.concatenate([[True], apart]), np.concatenate([apart, [True]])
            ends = (first[keep[0]], last[keep[1]]) if len(first) else (first, last)
            recording.derived["measured rows"] = cls(ends[0], ends[1], recording.rate_hz)
        found: Measured = recording.derived["measured rows"]
        return found

    def __len__(self) -> int:
        return int((self.last - self.first).sum())

    @property
    def seconds(self) -> float:
        return len(self) / self.rate_hz

    @property
    def pauses(self) -> Rows:
        """Numbers of the measured rows that follow a pause."""
        return np.cumsum(self.last - self.first)[:-1]

    def rows(self, numbers: Rows) -> Rows:
        """Rows of the recording; the number after the last one is the row after it."""
        starts = np.concatenate([[0], self.pauses])
        stretch = np.searchsorted(starts, numbers, side="right") - 1
        result: Rows = self.first[stretch] + numbers - starts[stretch]
        return result

    def between(self, begin: int, end: int) -> list[tuple[int, int]]:
        """First row and last + 1 of each stretch of the measured rows ``begin`` … ``end`` − 1."""
        starts = np.concatenate([[0], self.pauses, [len(self)]])
        found = []
        for number, row in enumerate(self.first.tolist()):
            a, b = max(begin, int(starts[number])), min(end, int(starts[number + 1]))
            if a < b:
                found.append((row + a - int(starts[number]), row + b - int(starts[number])))
        return found


@dataclass(frozen=True)
class SplitBlock:
    """A share of one recording with a role."""

    role: Role
    share: float


def split(
    recordings: Sequence[Recording], splits: Splits, where: object, machine: Machine | None = None
) -> tuple[tuple[Recording, ...], dict[str, Role]]:
    """Roles for the ``motion`` recordings; a recording with several roles is cut into ``name#1``, ``name#2`` …

    Roles named in the recipe come first. The rest is assigned in order: with three open roles and at least three recordings
    about 50 % fit, 25 % select, 25 % held out (at least one each); with fewer recordings than roles each is cut into blocks.
    Where some role then lacks motion of an axis that another assignment gives it, that one is used
    (:mod:`sysid.datasets.split_assignment`). A recording that is too short to be cut is for the fit. A copy of another
    recording has no role.

    Args:
        machine: its axes; without it the order alone decides.

    Raises:
        InputError: a recording of ``held_out_last`` is too short to be cut.
        SettingsError: the recipe names a recording that does not exist, or gives one recording, or a copy of it, two roles.
    """
    motion = [recording for recording in recordings if recording.kind == "motion"]
    roles = _named_roles([r.name for r in recordings], splits, where)
    for name in splits.held_out_last:
        if name not in [r.name for r in motion]:
            raise SettingsError(f"{where}: held_out_last", f"no recording {name!r}", nearest(name, [r.name for r in motion]))
        if name in roles:
            raise SettingsError(f"{where}: held_out_last", f"{name!r} is {roles[name]} as well", "one role a recording")
    copies = copies_of(motion)
    for copy, original in copies.items():
        if roles.get(copy, roles.get(original)) != roles.get(original):
            found = f"{copy!r} is {roles[copy]} and has the samples of {original!r}"
            expected = f"one role for the same samples, {roles[original]}" if original in roles else f"a role of {original!r}"
            raise SettingsError(f"{where}: splits", found, expected, f"Leave {copy!r} out of [splits].")
    free = [r for r in motion if r.name not in roles and r.name not in splits.held_out_last and r.name not in copies]
    given = set(roles.values()) | (set(ROLES) if splits.held_out_last else set())
    open_roles: list[Role] = [role for role in ROLES if role not in given]
    blocks: dict[str, tuple[SplitBlock, ...]] = {}
    if free and not open_roles:
        roles |= dict.fromkeys((r.name for r in free), "fit")
    elif free:
        table = motion_table(free, machine) if machine is not None else None
        whole, blocks = _assigned(free, open_roles, splits.guard_s, table)
        roles |= whole
    for name, share in splits.held_out_last.items():
        recording = next(r for r in motion if r.name == name)
        earlier = block_pattern(["fit", "select"], (1.0 - share) * Measured.of(recording).seconds)
        blocks[name] = (*(SplitBlock(b.role, b.share * (1.0 - share)) for b in earlier), SplitBlock("held_out", share))
    result: list[Recording] = []
    for recording in recordings:
        if recording.name not in blocks:
            result.append(recording)
            continue
        for part, role in cut(recording, blocks[recording.name], splits.guard_s, where):
            result.append(part)
            roles[part.name] = role
    return tuple(result), roles


def copies_of(recordings: Sequence[Recording]) -> dict[str, str]:
    """Recording of motion → an earlier one with the same samples in every signal; without measured motion it is none."""
    seen: dict[object, list[Recording]] = {}
    found: dict[str, str] = {}
    for recording in recordings:
        measured = [recording.values(signal) for signal in recording.signals if not signal.endswith(".command")]
        if recording.kind != "motion" or not any(map(_varies, measured)):
            continue
        step = max(len(recording) // _COMPARED, 1)
        some = tuple(values[::step].tobytes() for values in measured)
        alike = seen.setdefault((len(recording), recording.signals, some), [])
        for other in alike:
            pairs = [(recording.values(signal), other.values(signal)) for signal in recording.signals]
            if all(np.array_equal(one[a:b], two[a:b], equal_nan=True) for one, two in pairs for a, b in pieces(len(one))):
                found[recording.name] = other.name
                break
        else:
            alike.append(recording)
    return found


def copy_notes(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A note on each copy."""
    return tuple(
        f"{copy} has the same samples as {original}: a copy gets no role" for copy, original in copies_of(recordings).items()
    )


def _varies(values: Array) -> bool:
    there = known(values)
    return len(there) > 0 and bool(there.min() < there.max())


def _assigned(
    recordings: Sequence[Recording], roles: list[Role], guard_s: float, table: MotionTable | None
) -> tuple[dict[str, Role], dict[str, tuple[SplitBlock, ...]]]:
    """Roles of whole recordings, and the blocks of those that are cut."""
    names = [r.name for r in recordings]
    patterns = [block_pattern(roles, Measured.of(r).seconds) for r in recordings]
    long = [can_be_cut(r, pattern, guard_s) for r, pattern in zip(recordings, patterns, strict=True)]
    if len(names) >= len(roles):
        shared = _share_out(names, roles)
        present = np.array([roles.index(shared[name]) for name in names])
    else:
        present = np.array([len(roles) if enough else 0 for enough in long])
    choice = present
    if table is not None and len(roles) > 1:
        usable = [pattern if enough else () for pattern, enough in zip(patterns, long, strict=True)]
        choice = assignment_of(recordings, roles, usable, guard_s, table).best(present)
    whole = {name: roles[option] for name, option in zip(names, choice, strict=True) if option < len(roles)}
    return whole, {name: patterns[row] for row, name in enumerate(names) if choice[row] == len(roles)}


def assignment_of(
    recordings: Sequence[Recording],
    roles: Sequence[Role],
    patterns: Sequence[Sequence[SplitBlock]],
    guard_s: float,
    table: MotionTable,
) -> Assignment:
    """The assignment problem of ``recordings`` to ``roles``: each as a whole, or cut into the blocks of its pattern, if any.

    Cuts are counted where the shares of the blocks are, not at the phase of rest nearby.
    """
    count, options = len(recordings), len(roles) + 1
    motion = [table.recordings[r.name] for r in recordings]
    every = np.stack([m.amounts() for m in motion])
    amounts = np.zeros((count, options, len(roles), *every.shape[1:]))
    seconds = np.zeros((count, options, len(roles)))
    allowed = np.ones((count, options), dtype=bool)
    for k in range(len(roles)):
        amounts[:, k, k], seconds[:, k, k] = every, [m.seconds for m in motion]
    for row, (recording, pattern) in enumerate(zip(recordings, patterns, strict=True)):
        allowed[row, -1] = bool(pattern)
        guard, begin, measured = guard_s * recording.rate_hz, 0.0, Measured.of(recording)
        for number, block in enumerate(pattern):
            end = begin + block.share * len(measured)
            last = end if number == len(pattern) - 1 else end - guard
            k = list(roles).index(block.role)
            for stretch in measured.between(round(begin), round(last)):
                amounts[row, -1, k] += motion[row].amounts(*stretch)
            seconds[row, -1, k] += max(last - begin, 0.0) / recording.rate_hz
            begin = end
    needs = RoleNeeds.of(roles, every.sum(axis=0))
    return Assignment(needs, amounts, seconds, allowed, np.arange(options) == len(roles), MIN_ROLE_S)


def _named_roles(names: list[str], splits: Splits, where: object) -> dict[str, Role]:
    roles: dict[str, Role] = {}
    wanted: Mapping[Role, tuple[str, ...]] = {"fit": splits.fit, "select": splits.select, "held_out": splits.held_out}
    for role, patterns in wanted.items():
        for pattern in patterns:
            matched = [name for name in names if fnmatchcase(name, pattern)]
            if not matched:
                raise SettingsError(f"{where}: splits.{role}", f"no recording {pattern!r}", nearest(pattern, names))
            for name in matched:
                if roles.get(name, role) != role:
                    raise SettingsError(
                        f"{where}: splits", f"{name!r} is both {roles[name]} and {role}", "one role a recording"
                    )
                roles[name] = role
    return roles


def with_roles(roles: Mapping[str, Role], wanted: Mapping[Role, Sequence[str]], where: object) -> dict[str, Role]:
    """``roles`` with new ones for the recordings (or blocks) that match the globs of ``wanted``.

    Raises:
        SettingsError: no such recording, two roles for one, or nothing wanted.
    """
    fit, select, held_out = (tuple(wanted.get(role, ())) for role in ROLES)
    splits = Splits(fit=fit, select=select, held_out=held_out)
    named = _named_roles(list(roles), splits, where)
    if not named:
        raise SettingsError(where, "no role", "--fit, --select or --held-out with recordings")
    return {**roles, **named}


def _share_out(names: list[str], roles: list[Role]) -> dict[str, Role]:
    """Recordings in order: the first for fit, the last held out."""
    count = len(names)
    held = max(1, count // 4) if "held_out" in roles else 0
    select = max(1, math.ceil(count / 4) if held else round(count / 3)) if "select" in roles else 0
    if "fit" not in roles:
        select = count - held if select else 0
        held = count - select
    fit = count - held - select
    order: list[Role] = ["fit"] * fit + ["select"] * select + ["held_out"] * held  # type: ignore[assignment]
    return dict(zip(names, order, strict=True))


def block_pattern(roles: list[Role], length_s: float) -> tuple[SplitBlock, ...]:
    """Contiguous blocks of one recording: fit twice as long as select, the last quarter held out."""
    held = 0.25 if "held_out" in roles else 0.0
    before: list[Role] = [role for role in roles if role != "held_out"]
    weights = {"fit": 2.0, "select": 1.0}
    total = sum(weights[role] for role in before)
    pairs = 2 if len(before) == 2 and length_s * (1.0 - held) >= LONG_S else 1
    blocks = [SplitBlock(role, (1.0 - held) * weights[role] / total / pairs) for _ in range(pairs) for role in before]
    return (*blocks, SplitBlock("held_out", held)) if held else tuple(blocks)


def can_be_cut(recording: Recording, blocks: Sequence[SplitBlock], guard_s: float) -> bool:
    """Whether every block has at least :data:`MIN_ROLE_S` beside the guards."""
    return Measured.of(recording).seconds >= least_cut_s(len(blocks), guard_s)


def cut(recording: Recording, blocks: Sequence[SplitBlock], guard_s: float, where: object) -> list[tuple[Recording, Role]]:
    """``recording`` as ``name#1``, ``name#2`` …; each begins behind a pause or at the least motion nearby, behind the guard.

    A free run of a block begins with an estimated state, which rest determines best. No block contains a pause
    (:data:`PAUSE_S`): one that would is two of the same role.

    Raises:
        InputError: the recording is too short to be cut.
    """
    guard = round(guard_s * recording.rate_hz)
    measured = Measured.of(recording)
    rows, pauses = len(measured), measured.pauses
    if not can_be_cut(recording, blocks, guard_s):
        raise InputError(
            f"{where}: recording {recording.name!r}",
            f"{rows / recording.rate_hz:.1f} s are too short for {len(blocks)} blocks",
            f"{least_cut_s(len(blocks), guard_s):g} s: {MIN_ROLE_S:g} s a block and {guard_s:g} s of guard",
            f"{cut_advice(guard_s)} Without held_out_last it is kept whole.",
        )
    edges = [0]
    total = 0.0
    shortest = min(block.share for block in blocks)
    motion = _motion(recording)
    least = math.ceil(MIN_ROLE_S * recording.rate_hz) + guard
    for number, block in enumerate(blocks[:-1], start=1):
        total += block.share
        reach = int(0.15 * shortest * rows)
        fits = edges[-1] + least, rows - (len(blocks) - number) * least
        low, high = (int(np.clip(round(total * rows) + away, *fits)) for away in (-reach, reach))
        near = pauses[(pauses >= low) & (pauses <= high)]
        if len(near):
            edges.append(int(near[np.argmin(np.abs(near - total * rows))]))
        else:
            edges.append(low + int(np.argmin(motion[measured.rows(np.arange(low, high + 1))])))
    edges.append(rows)
    parts: list[tuple[Recording, Role]] = []
    for block, begin, end in zip(blocks, edges[:-1], edges[1:], strict=True):
        last = end if end == rows or end in pauses else end - guard
        for first, behind in measured.between(begin, last):
            parts.append((rows_of(recording, f"{recording.name}#{len(parts) + 1}", first, behind), block.role))
    return parts


def rows_of(recording: Recording, name: str, first: int, last: int) -> Recording:
    """Rows ``first`` … ``last`` − 1 of a recording as one of its own, whose time begins at zero."""
    table = recording.table.iloc[first:last].reset_index(drop=True)
    table["time"] = computed(len(table), lambda a, b: np.arange(a, b) / recording.rate_hz)
    table.attrs = dict(recording.table.attrs)
    start_ns = recording.start_ns + round(first / recording.rate_hz * 1e9)
    return Recording(name, table, recording.rate_hz, recording.kind, start_ns)


def _motion(recording: Recording) -> Array:
    """Change of the measured signals around each row, each relative to its spread; large beside gaps, (rows,)."""
    width = max(int(0.25 * recording.rate_hz), 1)
    rows = len(recording)
    motion: Array = filled(rows, 0.0)
    for signal in recording.signals:
        values = recording.values(signal)
        there = known(values)
        spread = deviation(there) if len(there) else 0.0
        if spread == 0.0 or signal.endswith(".command"):
            continue
        bridged = _bridged(values)
        for first, last in pieces(rows):
            after = bridged[np.minimum(np.arange(first + width, last + width), rows - 1)]
            before = bridged[np.maximum(np.arange(first - width, last - width), 0)]
            motion[first:last] += np.abs(after - before) / spread
    return motion


def _bridged(values: Array) -> Array:
    """A signal (n,) with missing values interpolated linearly; itself where nothing is missing."""
    missing = np.isnan(values)
    first, last = stretches(missing)
    if not len(first):
        return values
    ends = np.concatenate([first - 1, last])
    ends = np.unique(ends[(ends >= 0) & (ends < len(values))])
    rows = np.flatnonzero(missing)
    result: Array = copied(values)
    result[rows] = np.interp(rows, ends, values[ends])
    return result
