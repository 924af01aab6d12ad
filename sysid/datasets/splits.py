"""Assignment of recordings to fit, selection and held-out, as a whole or in contiguous blocks with a guard, never by sample."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import copied, deviation, known, stretches
from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Recording, Role
from sysid.errors import InputError, SettingsError, nearest
from sysid.scratch import computed, filled, pieces

ROLES: tuple[Role, ...] = ("fit", "select", "held_out")
#: Shortest block [s].
MIN_BLOCK_S = 4.0
#: From this length on a recording is cut into two pairs of fit and select blocks, so that both contain early and late
#: conditions [s].
LONG_S = 60.0


@dataclass(frozen=True)
class SplitBlock:
    """A share of one recording with a role."""

    role: Role
    share: float


def split(recordings: Sequence[Recording], splits: Splits, where: object) -> tuple[tuple[Recording, ...], dict[str, Role]]:
    """Roles for the ``motion`` recordings; a recording with several roles is cut into ``name#1``, ``name#2`` …

    Roles named in the recipe come first. The rest is assigned in order: with three open roles and at least three recordings
    about 50 % fit, 25 % select, 25 % held out (at least one each); with fewer recordings than roles each is cut into blocks.

    Raises:
        SettingsError: the recipe names a recording that does not exist, or gives one recording two roles.
    """
    motion = [recording for recording in recordings if recording.kind == "motion"]
    roles = _named_roles([r.name for r in recordings], splits, where)
    for name in splits.held_out_last:
        if name not in [r.name for r in motion]:
            raise SettingsError(f"{where}: held_out_last", f"no recording {name!r}", nearest(name, [r.name for r in motion]))
        if name in roles:
            raise SettingsError(f"{where}: held_out_last", f"{name!r} is {roles[name]} as well", "one role a recording")
    free = [r.name for r in motion if r.name not in roles and r.name not in splits.held_out_last]
    given = set(roles.values()) | ({"fit", "select", "held_out"} if splits.held_out_last else set())
    open_roles: list[Role] = [role for role in ("fit", "select", "held_out") if role not in given]
    blocks: dict[str, tuple[SplitBlock, ...]] = {}
    if free and not open_roles:
        roles |= dict.fromkeys(free, "fit")
    elif len(free) >= len(open_roles):
        roles |= _share_out(free, open_roles)
    else:
        length = {r.name: len(r) / r.rate_hz for r in motion}
        blocks |= {name: _blocks(open_roles, length[name]) for name in free}
    for name, share in splits.held_out_last.items():
        recording = next(r for r in motion if r.name == name)
        earlier = _blocks(["fit", "select"], (1.0 - share) * len(recording) / recording.rate_hz)
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


def _blocks(roles: list[Role], length_s: float) -> tuple[SplitBlock, ...]:
    """Contiguous blocks of one recording: fit twice as long as select, the last quarter held out."""
    held = 0.25 if "held_out" in roles else 0.0
    before: list[Role] = [role for role in roles if role != "held_out"]
    weights = {"fit": 2.0, "select": 1.0}
    total = sum(weights[role] for role in before)
    pairs = 2 if len(before) == 2 and length_s * (1.0 - held) >= LONG_S else 1
    blocks = [SplitBlock(role, (1.0 - held) * weights[role] / total / pairs) for _ in range(pairs) for role in before]
    return (*blocks, SplitBlock("held_out", held)) if held else tuple(blocks)


def cut(recording: Recording, blocks: Sequence[SplitBlock], guard_s: float, where: object) -> list[tuple[Recording, Role]]:
    """``recording`` as ``name#1``, ``name#2`` …; each cut is at the least motion nearby.

    Raises:
        InputError: the recording is too short to be cut.
    """
    guard = round(guard_s * recording.rate_hz)
    rows = len(recording)
    if rows < (MIN_BLOCK_S + guard_s) * recording.rate_hz * len(blocks):
        raise InputError(
            f"{where}: recording {recording.name!r}",
            f"{rows / recording.rate_hz:.1f} s are too short for {len(blocks)} blocks",
            f"at least {MIN_BLOCK_S:g} s a block and {guard_s:g} s of guard",
            "Record longer, or three times: then recordings are split whole. To keep it whole without a held-out part, write "
            f'in the recipe: `[splits]`, `fit = ["{recording.name}"]`.',
        )
    edges = [0]
    total = 0.0
    shortest = min(block.share for block in blocks)
    motion = _motion(recording)
    for block in blocks[:-1]:
        total += block.share
        reach = int(0.15 * shortest * rows)
        low = max(round(total * rows) - reach, edges[-1] + 1)
        edges.append(low + int(np.argmin(motion[low : round(total * rows) + reach + 1])))
    edges.append(rows)
    parts = []
    for number, (block, start, end) in enumerate(zip(blocks, edges[:-1], edges[1:], strict=True), start=1):
        first = start if number == 1 else start + guard - guard // 2
        last = end if number == len(blocks) else end - guard // 2
        table = recording.table.iloc[first:last].reset_index(drop=True)
        table["time"] = computed(len(table), lambda a, b: np.arange(a, b) / recording.rate_hz)
        table.attrs = dict(recording.table.attrs)
        start_ns = recording.start_ns + round(first / recording.rate_hz * 1e9)
        parts.append((Recording(f"{recording.name}#{number}", table, recording.rate_hz, recording.kind, start_ns), block.role))
    return parts


def _motion(recording: Recording) -> npt.NDArray[np.float64]:
    """Change of the measured signals around each row, each relative to its spread; large beside gaps, (rows,)."""
    width = max(int(0.25 * recording.rate_hz), 1)
    rows = len(recording)
    motion: npt.NDArray[np.float64] = filled(rows, 0.0)
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


def _bridged(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """A signal (n,) with missing values interpolated linearly; itself where nothing is missing."""
    missing = np.isnan(values)
    first, last = stretches(missing)
    if not len(first):
        return values
    ends = np.concatenate([first - 1, last])
    ends = np.unique(ends[(ends >= 0) & (ends < len(values))])
    rows = np.flatnonzero(missing)
    result: npt.NDArray[np.float64] = copied(values)
    result[rows] = np.interp(rows, ends, values[ends])
    return result
