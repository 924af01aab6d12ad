"""The axes that the columns show: which is the command, which the motion, how it answers, and in which units."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.drafting.fields import MAX_SECONDS, Field
from sysid.datasets.drafting.question import Answers, Question
from sysid.datasets.plausibility.response import MAX_DELAY_S, Motion, correlation, response_of
from sysid.datasets.quality.responses import speed
from sysid.datasets.words import words_of
from sysid.errors import SettingsError, nearest
from sysid.machine import Axis
from sysid.names import listed, slug
from sysid.units import si_factor

Array = npt.NDArray[np.float64]

#: Rate at which columns are compared [Hz].
RATE_HZ = 20.0
#: Least correlation of a command and its motion; of a commanded position; difference at which one of two kinds is sure.
ANSWERS, FOLLOWS, SURE = 0.2, 0.9, 0.1
#: Correlation of a motion and the integral of its command above which it may be computed from it: a real axis answers later.
COMPUTED = 0.9995
#: Largest angle that may be in radians; largest in degrees.
RADIANS, DEGREES = 2.1 * math.pi, 400.0
#: Largest length that may be in metres, and least that cannot be.
METRES, MILLIMETRES = 3.0, 20.0
LENGTHS = ("mm", "cm", "m")
#: Least gain [m/s or rad/s].
SMALLEST = 1e-9
#: A recording drives an axis if its command covers this share of its range.
DRIVEN = 0.5
#: A recording in another unit differs by its ratio, to within this factor.
APART = 2.5
#: What an answer may assign a column to, and what its name then says.
ASSIGNED = {"command": "command", "motion": "measured"}
#: A command within this range is a share of the full one already.
UNIT_COMMAND = 1.05
#: Usual full scales of a command; one is taken if the largest command is within this share of it.
SCALES, NEAR = (1.0, 100.0, 127.0, 255.0, 500.0, 1000.0, 1023.0, 2047.0, 4095.0, 32767.0), 0.02
#: A motion at rest, as a share of the 95th percentile of its speed; commands that count as full, as a share.
RESTS, FULL = 0.05, 0.8

KINDS = {"hydraulic": "velocity", "servo": "position", "force": "force"}


@dataclass(frozen=True)
class AxisDraft:
    """An axis as the data show it.

    Args:
        actuation: ``velocity``, ``position`` or ``force``; ``drives``: ``cylinder`` or ``joint``.
        zero, span, sign: of the command, in raw values.
        unit: of the motion (raw); of the command of a position axis too.
        gain: speed at full command [SI], of a valve axis; ``inertia``: of a force axis.
        ends: range of the motion [SI].
        notes: by key of machine.toml or the recipe, from which data it is and how sure.
        units: of recordings whose motion has another unit.
    """

    name: str
    command: Field
    motion: Field
    actuation: str
    drives: str
    zero: float
    span: float
    sign: int
    unit: str
    command_unit: str | None
    gain: float
    inertia: float
    ends: tuple[float, float]
    notes: Mapping[str, str]
    units: Mapping[str, str] = field(default_factory=dict)


def axes_of(fields: Sequence[Field], answers: Answers, kind: str | None = None) -> tuple[list[AxisDraft], list[str]]:
    """The axes in the order of their columns, and why others are left out.

    Args:
        kind: hydraulic, servo or force; None: as the data show.
    """
    groups: dict[str, list[Field]] = {}
    for each in _assigned(fields, answers):
        groups.setdefault(each.axis, []).append(each)
    pairs, left = dict[str, tuple[Field, Field, str, dict[str, str]]](), list[str]()
    for words, group in groups.items():
        name = f"axis_{words}" if words.isdecimal() else slug(words, "axis").replace("-", "_") if words else "axis"
        numbered = (f"{name}_{k}" for k in itertools.count(2))
        name = name if name not in pairs else next(each for each in numbered if each not in pairs)
        commands = [f for f in group if "command" in f.says and "operator" not in f.says]
        forces = [f for f in group if "force" in f.says and not f.says & {"command", "operator"}]
        if kind == "force" and forces and not any("force" in f.says for f in commands):
            commands = forces
        motions = [f for f in group if not f.says & {"command", "operator", "force"} and f.says != {"speed"}]
        motions = [f for f in motions if "speed" not in f.says] or motions
        commands = commands or [f for f in forces if motions] or [f for f in group if "operator" in f.says]
        if not commands or not motions:
            labels = ", ".join(f.label for f in group)
            left.append(f"{labels}: no {'command' if not commands else 'motion'} beside it by name")
            continue
        compared = [(c, m, _compared(c, m)) for c in commands for m in motions]
        command, motion, how = max(compared, key=lambda pair: max(pair[2].values()))
        if max(how.values()) < ANSWERS and not ("force" in command.says or kind == "force"):
            left.append(f"{motion.label} does not answer {command.label} (correlation {max(how.values()):.2f})")
            continue
        same = _integrated(command, motion)
        if same > COMPUTED and answers.of(_measured(name, command, motion, same)) == "no":
            left.append(f"{motion.label}: computed from {command.label}, not measured")
            continue
        left += [f"{f.label}: {name} has {command.label} and {motion.label}" for f in group if f not in (command, motion)]
        notes: dict[str, str] = {}
        pairs[name] = command, motion, _actuation(name, command, how, answers, kind, notes), notes
    units = _units({name: (motion, actuation) for name, (_, motion, actuation, _) in pairs.items()}, answers)
    unstated = {name: pair for name, pair in pairs.items() if pair[1].unit is None and pair[2] == "velocity"}
    other = _other_units({name: (command, motion) for name, (command, motion, _, _) in unstated.items()}, units, answers)
    found = []
    for name, (command, motion, actuation, notes) in pairs.items():
        drives, unit, notes["unit"] = units[name]
        its = other if name in unstated else {}
        scaled = _in_one_unit(motion, unit, its)
        found.append(replace(_axis(name, command, scaled, actuation, drives, unit, notes), motion=motion, units=its))
    return found, left


def _other_units(
    pairs: Mapping[str, tuple[Field, Field]], units: Mapping[str, tuple[str, str, str]], answers: Answers
) -> dict[str, str]:
    """Recordings whose motions are in a coarser unit of length: most of them are smaller and slower by its ratio."""
    votes = Counter(vote for name, pair in pairs.items() for vote in _coarser(*pair, units[name][1]))
    found: dict[str, str] = {}
    for (recording, coarser, ratio), count in votes.items():
        if 2 * count > len(pairs):
            labels = listed([motion.label for _, motion in pairs.values()], 3)
            why = f"{labels} in {recording}: {ratio:.0f} times smaller and slower than in the others"
            found[recording] = answers.of(Question(f"unit.{recording}", coarser, why, LENGTHS))
    return found


def _coarser(command: Field, motion: Field, unit: str) -> Iterator[tuple[str, str, float]]:
    """Recording, unit and ratio where a motion is smaller and slower by the ratio of a coarser unit."""
    if unit not in LENGTHS:
        return
    speeds, places = dict[str, float](), dict[str, float]()
    known = {one.recording: one.values[np.isfinite(one.values)] for one in command.series}
    whole = float(np.ptp(command.values))
    driven = {recording for recording, values in known.items() if len(values) and np.ptp(values) >= DRIVEN * whole}
    for one in (one for one in motion.series if one.recording in driven):
        moved = speed(_together(command, replace(motion, series=(one,)))[1], RATE_HZ)
        size = float(np.nanquantile(np.abs(moved), 0.95)) if np.isfinite(moved).any() else 0.0
        if size > 0.0:
            speeds[one.recording], places[one.recording] = size, abs(float(np.nanmedian(one.values)))
    if not speeds:
        return
    usual, place = float(np.median([*speeds.values()])), float(np.median([*places.values()]))
    for recording, size in speeds.items():
        for coarser in LENGTHS[LENGTHS.index(unit) + 1 :]:
            ratio = si_factor(coarser)[0] / si_factor(unit)[0]
            both = usual / size, place / places[recording] if places[recording] else math.inf
            if all(ratio / APART < each < ratio * APART for each in both):
                yield recording, coarser, ratio


def _in_one_unit(motion: Field, unit: str, other: Mapping[str, str]) -> Field:
    """The motion with all of its recordings in ``unit``."""
    ratio = {recording: si_factor(its)[0] / si_factor(unit)[0] for recording, its in other.items()}
    return replace(
        motion, series=tuple(replace(one, values=one.values * ratio.get(one.recording, 1.0)) for one in motion.series)
    )


def _integrated(command: Field, motion: Field) -> float:
    """Correlation of the way in a second with the integral of the command, without a delay."""
    areas = [
        replace(one, values=np.concatenate([[0.0], np.cumsum(np.nan_to_num(one.values[:-1]) * np.diff(one.time))]))
        for one in command.series
    ]
    area, place = _together(replace(command, series=tuple(areas)), motion, held=False)
    rows = round(RATE_HZ)
    way, meant = place[rows:] - place[:-rows], area[rows:] - area[:-rows]
    known = np.isfinite(way) & np.isfinite(meant)
    if np.count_nonzero(known) < 2 * rows or not (np.ptp(way[known]) > 0.0 and np.ptp(meant[known]) > 0.0):
        return 0.0
    # A neutral that is not zero adds the same to every second.
    return abs(float(np.corrcoef(way[known], meant[known])[0, 1]))


def _assigned(fields: Sequence[Field], answers: Answers) -> list[Field]:
    """The columns, those that an answer assigns (``boom.command=COLUMN``, ``boom.motion=COLUMN``) with that axis and quantity.

    Raises:
        SettingsError: no such column.
    """
    assigned = dict[str, Field]()
    by_label = {label: each for each in fields for label in (each.name, each.label)}
    for key, label in answers.given.items():
        axis, _, quantity = key.rpartition(".")
        if quantity not in ASSIGNED or not axis:
            continue
        if label not in by_label:
            raise SettingsError(f"--set {key}={label}", "no such column that changes", nearest(label, by_label))
        answers.used.add(key)
        column = by_label[label]
        assigned[column.label] = replace(
            column, axis=axis, says=frozenset({ASSIGNED[quantity]}) | column.says & {"force", "cylinder"}
        )
    axes = {column.axis for column in assigned.values()}
    return [assigned.get(column.label, column) for column in fields if column.label in assigned or column.axis not in axes]


def _measured(name: str, command: Field, motion: Field, strength: float) -> Question:
    why = f"{motion.label} is the integral of {command.label} (correlation {strength:.5f}): measured, or computed from it"
    return Question(f"{name}.measured", "no", why, ("yes", "no"))


def _compared(command: Field, motion: Field) -> dict[str, float]:
    """How well the speed, and the position, follow the command: correlations."""
    u, x = _together(command, motion)
    delays = round(MAX_DELAY_S * RATE_HZ)
    return {"velocity": abs(correlation(u, speed(x, RATE_HZ), delays)), "position": abs(correlation(u, x, delays))}


def _together(command: Field, motion: Field, held: bool = True) -> tuple[Array, Array]:
    """Command (held between its samples) and motion of all recordings on one even grid, (n,) each; NaN between recordings."""
    gap, parts = np.full(round(MAX_DELAY_S * RATE_HZ) + 2, np.nan), []
    for one in command.series:
        for other in motion.series:
            if one.recording != other.recording or len(one.time) < 2 or len(other.time) < 2:
                continue
            begin = max(one.time[0], other.time[0])
            grid = np.arange(begin, min(one.time[-1], other.time[-1], begin + MAX_SECONDS), 1.0 / RATE_HZ)
            if not len(grid):
                continue
            before = one.values[np.clip(np.searchsorted(one.time, grid, "right") - 1, 0, len(one.values) - 1)]
            given = before if held else np.interp(grid, one.time, one.values)
            known = np.isfinite(other.values)
            moved = np.interp(grid, other.time[known], other.values[known]) if known.any() else np.full(len(grid), np.nan)
            parts.append((given, moved))
    if not parts:
        return gap, gap
    u, x = (np.concatenate([part for pair in zip(column, [gap] * len(parts), strict=True) for part in pair])
            for column in zip(*parts, strict=True))  # fmt: skip
    return u, x


def _axis(name: str, command: Field, motion: Field, actuation: str, drives: str, unit: str, notes: dict[str, str]) -> AxisDraft:
    u, x = _together(command, motion)
    moved = speed(x, RATE_HZ)
    command_unit, zero, span, sign, gain, inertia = None, 0.0, 1.0, 1, 1.0, math.nan
    factor = si_factor(unit)[0]
    if actuation == "velocity":
        zero, span = _neutral(u, moved, notes)
        share = (u - zero) / span
        sign = -1 if np.nansum(share * _later(moved, share)) < 0.0 else 1
        gain = _gain(sign * share, factor * moved, notes)
    elif actuation == "position":
        command_unit = command.unit or unit
    else:
        command_unit = command.unit or ("N" if unit in LENGTHS else "N·m")
        inertia = _inertia(u * si_factor(command_unit)[0], factor * x, notes)
    values = motion.values * factor
    notes["ends"] = "the range that the logs contain: where it is not the end stops, widen it"
    if actuation == "position":
        values = np.concatenate([values, command.values * si_factor(command_unit or unit)[0]])
        notes["ends"] = "the range of commands and motion in the logs: where it is not the end stops, widen it"
    ends = float(values.min()), float(values.max())
    return AxisDraft(name, command, motion, actuation, drives, zero, span, sign, unit, command_unit, gain, inertia, ends, notes)


def _inertia(force: Array, place: Array, notes: dict[str, str]) -> float:
    """Moving mass or inertia of a force axis; one, which is said to be assumed, where the recordings do not show it."""
    rate = speed(place, RATE_HZ)
    motion = Motion(force, place, rate, speed(rate, RATE_HZ), 1.0 / RATE_HZ)
    found = response_of(motion, Axis(name="axis", actuation="force", drives="joint", inertia=1.0, limits=(-1.0, 1.0)))
    if found is None or not found.value > 0.0:
        notes["inertia"] = "assumed: these logs do not show it"
        return 1.0
    notes["inertia"] = "from force and acceleration, beside friction and weight"
    return found.value


def _actuation(
    name: str, command: Field, how: Mapping[str, float], answers: Answers, kind: str | None, notes: dict[str, str]
) -> str:
    if kind is not None:
        return KINDS[kind]
    if "force" in command.says:
        notes["actuation"] = f"{command.label} is a force or torque by its name"
        return "force"
    likely = "position" if how["position"] >= max(how["velocity"], FOLLOWS) else "velocity"
    shown = f"correlation of the command with the speed {how['velocity']:.2f}, with the position {how['position']:.2f}"
    notes["actuation"] = shown
    if abs(how["position"] - how["velocity"]) >= SURE:
        return likely
    question = Question(f"{name}.actuation", likely, f"{command.label}: {shown}", ("velocity", "position", "force"))
    return answers.of(question)


def _units(pairs: Mapping[str, tuple[Field, str]], answers: Answers) -> dict[str, tuple[str, str, str]]:
    """What each command drives, the unit of its motion, and where that is from; motions without a unit are decided together.

    Args:
        pairs: name of an axis → its motion, and its actuation.
    """
    found = {}
    unknown = {name: motion for name, (motion, _) in pairs.items() if motion.unit is None}
    valves = {name: motion for name, motion in unknown.items() if pairs[name][1] == "velocity"}
    angles = {name for name, motion in valves.items() if {"angle", "joint", "deg", "rad"} & {*words_of(motion.name)}}
    plain = [name for name, motion in valves.items() if name not in angles and "cylinder" not in motion.says]
    cylinders = {name for name in valves if name not in angles}
    if plain:
        why = f"{_ranges(plain, unknown)}: lengths of cylinders, or angles of joints"
        if answers.of(Question("drives", "cylinder", why, ("cylinder", "joint"))) == "joint":
            cylinders -= set(plain)
    for names in (sorted(cylinders, key=[*pairs].index), [name for name in unknown if name not in cylinders]):
        if not names:
            continue
        most = max(float(np.abs(unknown[name].values).max()) for name in names)
        ranges = _ranges(names, unknown)
        why = f"{ranges}; the unit is not stated"
        if names[0] in cylinders:
            likely = "mm" if most >= MILLIMETRES else "cm"
            unit = "m" if most <= METRES else answers.of(Question("unit", likely, why, LENGTHS))
        elif most <= DEGREES:
            unit = "rad" if most <= RADIANS else "deg"
        else:
            unit = answers.of(Question("unit", "deg", why, ("deg", "rad", *LENGTHS)))
        for name in names:
            found[name] = ("cylinder" if name in cylinders else "joint"), unit, f"not stated; {ranges}"
    for name, (motion, actuation) in pairs.items():
        if motion.unit is not None:
            drives = "cylinder" if motion.unit in LENGTHS and actuation == "velocity" else "joint"
            found[name] = drives, motion.unit, "stated in the file"
    return found


def _ranges(names: Sequence[str], motions: Mapping[str, Field]) -> str:
    shown = [f"{motions[name].label} {motions[name].values.min():.4g} … {motions[name].values.max():.4g}" for name in names]
    return listed(shown, 4)


def _neutral(u: Array, moved: Array, notes: dict[str, str]) -> tuple[float, float]:
    """Neutral value of a command, and the distance from it to the full one, in raw values."""
    known = u[np.isfinite(u)]
    low, high = float(known.min()), float(known.max())
    if low >= -UNIT_COMMAND and high <= UNIT_COMMAND:
        return 0.0, 1.0
    there = np.isfinite(u) & np.isfinite(moved)
    rest = there & (np.abs(moved) <= RESTS * np.quantile(np.abs(moved[there]), 0.95))
    values, counts = np.unique(np.round(u[rest] if rest.any() else known, 9), return_counts=True)
    zero = float(values[np.argmax(counts)])
    zero = 0.0 if low < 0.0 < high and abs(zero) < NEAR * (high - low) else zero
    span = max(high - zero, zero - low)
    notes["zero"] = f"where the axis rests most ({counts.max() / max(counts.sum(), 1):.0%} of its rest)"
    likely = min(SCALES, key=lambda scale: abs(scale - span))
    if zero == 0.0 and abs(likely - span) <= NEAR * likely:
        span = likely
    notes["span"] = f"from neutral to the largest command ({low:.4g} … {high:.4g})"
    return zero, span


def _later(moved: Array, share: Array) -> Array:
    """The speed moved to where it follows the command best."""
    best, most = moved, -1.0
    for lag in range(round(MAX_DELAY_S * RATE_HZ)):
        shifted = np.concatenate([moved[lag:], np.full(lag, np.nan)])
        size = abs(float(np.nansum(share * shifted)))
        if size > most:
            best, most = shifted, size
    return best


def _gain(share: Array, moved: Array, notes: dict[str, str]) -> float:
    """Speed at full positive command [SI]."""
    late = _later(moved, share)
    full = (share >= FULL) & np.isfinite(late)
    if np.count_nonzero(full) < 5:
        full = (np.abs(share) >= 0.5 * np.nanmax(np.abs(share))) & np.isfinite(late)
    gain = float(np.median(late[full] / share[full])) if full.any() else float("nan")
    notes["gain"] = f"median speed of {np.count_nonzero(full)} rows at large commands"
    return max(gain if gain > 0.0 else float(np.nanmax(np.abs(moved))), SMALLEST)
