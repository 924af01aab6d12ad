"""The axes that the columns show: which is the command, which the motion, how it answers, and in which units."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.datasets.checks.measures import LEAST_STRENGTH
from sysid.datasets.chunked import Array
from sysid.datasets.drafting.axis_values import Characteristic, characteristic, moved_mass
from sysid.datasets.drafting.fields import MAX_SECONDS, Answers, Field, Question
from sysid.datasets.quality.responses import MAX_DELAY_S, correlation, speed
from sysid.datasets.words import ANGLES, STRAIGHT, words_of
from sysid.errors import SettingsError, nearest
from sysid.machine.description import RESERVED
from sysid.names import listed, slug
from sysid.numbers import Positive, number
from sysid.units import si_factor

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
#: Counts of a servo's encoder as a unit; units of angles.
COUNTS = "4096/turn"
ANGLE_UNITS = ("deg", "rad", "turn", COUNTS, "1024/turn", "16384/turn")
#: Largest angle that is in radians, and least that is in degrees; a cylinder is not this share of its range below zero.
HALF_TURN, UNSURE, BELOW = 1.05 * math.pi, 4.0 * math.pi, 0.05
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
#: Usual raw commands at rest; one is proposed within this share of the range of the command from where the motion reverses.
NEUTRALS, ASIDE = (0.0, 0.5, 2.5, 5.0, 7.5, 50.0, 127.0, 128.0, 512.0, 1500.0, 2048.0, 32768.0), 0.06
#: A valve is faster than this [s]; a mass under a force is slower.
SLOW_S = 0.45
#: A pause of a motion is longer than this multiple of its median step, and than this [s].
PAUSE_STEPS, PAUSE_S = 4.0, 0.2
#: Rate at which the speeds of a valve axis are fitted [Hz], and the rows of that.
FINE_HZ, MAX_ROWS = 100.0, 2.0**18

#: The answer that leaves no recording out.
NOTHING = "none"
KINDS = {"hydraulic": "velocity", "servo": "position", "force": "force"}


@dataclass(frozen=True)
class AxisDraft:
    """An axis as the data show it.

    Args:
        actuation: ``velocity``, ``position`` or ``force``; ``drives``: ``cylinder`` or ``joint``.
        zero, span, sign: of the command, in raw values; ``scale``: force [its unit] for each 1 of the column.
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
    scale: float = 1.0


def axes_of(
    fields: Sequence[Field], answers: Answers, kind: str | None = None
) -> tuple[list[AxisDraft], list[str], dict[str, str]]:
    """The axes in the order of their columns, why others are left out, and recordings to leave out, with the reason.

    Args:
        kind: hydraulic, servo or force; None: as the data show.
    """
    pairs, left = _pairs(fields, answers, kind)
    without = _against(pairs, answers, kind)
    if without:
        kept = [replace(f, series=tuple(one for one in f.series if one.recording not in without)) for f in fields]
        pairs, left = _pairs([f for f in kept if f.series], answers, kind)
    actuations = _actuations(pairs, answers, kind)
    units = _units(pairs, actuations, answers)
    scales = _force_scales({name: pair.command for name, pair in pairs.items() if actuations[name] == "force"}, answers)
    unstated = {name: pair for name, pair in pairs.items() if pair.motion.unit is None and actuations[name] == "velocity"}
    other = _other_units({name: (pair.command, pair.motion) for name, pair in unstated.items()}, units, answers)
    found = []
    for name, pair in pairs.items():
        drives, unit, pair.notes["unit"] = units[name]
        its = other if name in unstated else {}
        scaled = pair if not its else replace(pair, motion=_in_one_unit(pair.motion, unit, its), fit=None)
        axis = _axis(name, scaled, actuations[name], drives, unit, scales.get(name, 1.0), answers)
        found.append(replace(axis, motion=pair.motion, units=its))
    return found, left, without


def _pairs(fields: Sequence[Field], answers: Answers, kind: str | None) -> tuple[dict[str, _Pair], list[str]]:
    """Axis → its command and motion; and why other columns are left out."""
    groups: dict[str, list[Field]] = {}
    for each in _assigned(fields, answers):
        groups.setdefault(each.axis, []).append(each)
    groups = _completed(groups, fields)
    pairs, left = dict[str, _Pair](), list[str]()
    for words, group in groups.items():
        name = slug(words, "axis").replace("-", "_") if words else "axis"
        name = f"axis_{name}" if name.isdecimal() or name in RESERVED else name
        numbered = (f"{name}_{k}" for k in itertools.count(2))
        name = name if name not in pairs else next(each for each in numbered if each not in pairs)
        commands = [f for f in group if "command" in f.says and "operator" not in f.says]
        forces = [f for f in group if "force" in f.says and not f.says & {"command", "operator"}]
        if kind == "force" and forces and not any("force" in f.says for f in commands):
            commands = forces
        motions = _motions(group)
        commands = commands or [f for f in forces if motions] or [f for f in group if "operator" in f.says]
        commands = commands or [f for f in group if f.says == {"speed"} and any(_is_setpoint(f, m) for m in motions)]
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
        valve = _likely(command, how) == "velocity" and kind in (None, "hydraulic")
        pairs[name] = _Pair(command, motion, how, _fitted(command, motion) if valve else None)
    return pairs, left


def _against(pairs: Mapping[str, _Pair], answers: Answers, kind: str | None) -> dict[str, str]:
    """Recordings in which a motion goes against its command, which it follows in most others: there it hardly acts.

    A force is followed by neither place nor speed: above its resonance a pendulum moves against the torque that drives it.
    """
    found = dict[str, str]()
    for pair in (pair for pair in pairs.values() if not (kind == "force" or (kind is None and "force" in pair.command.says))):
        quantity = max(pair.how, key=lambda key: pair.how[key])
        least, delays = LEAST_STRENGTH[quantity], round(MAX_DELAY_S * RATE_HZ)
        follows = dict[str, float]()
        for one in pair.motion.series:
            u, x = _together(pair.command, replace(pair.motion, series=(one,)))
            follows[one.recording] = correlation(u, speed(x, RATE_HZ) if quantity == "velocity" else x, delays)
        clear = {recording: value for recording, value in follows.items() if abs(value) >= least}
        usual = math.copysign(1.0, sum(math.copysign(1.0, value) for value in clear.values()))
        for recording, value in clear.items():
            if value * usual < 0.0:
                found[recording] = f"{pair.motion.label} goes against {pair.command.label} (correlation {value:.2f})"
    if not found:
        return {}
    why = f"{next(iter(found.values()))}, unlike in most others, in {listed([*found], 4)}: a motor that is off, or another sign"
    answer = answers.of(Question("left_out", ",".join(found), why))
    chosen = [name for name in answer.split(",") if name != NOTHING]
    for name in chosen:
        if name not in found:
            raise SettingsError(f"--set left_out={answer}", f"{name!r}", f"{NOTHING}, or some of {','.join(found)}")
    return {name: found[name] for name in chosen}


@dataclass(frozen=True)
class _Pair:
    """Command and motion of an axis, how one follows the other (correlations), and as a valve (None: too short)."""

    command: Field
    motion: Field
    how: Mapping[str, float]
    fit: Characteristic | None
    notes: dict[str, str] = field(default_factory=dict)


def _fitted(command: Field, motion: Field) -> Characteristic | None:
    """The motion as that of a valve."""
    rate = _fine_rate(command)
    return characteristic([*_parts(command, motion, rate)], rate)


def _fine_rate(command: Field) -> float:
    """Rate of the grid on which an axis is fitted [Hz]."""
    return min(FINE_HZ, MAX_ROWS / max(sum(float(np.ptp(one.time)) for one in command.series), 1.0))


def _is_setpoint(field: Field, motion: Field) -> bool:
    """Whether what is a speed by its name (``qd``) is the desired position: the motion follows it, and its speed does not."""
    how = _compared(field, motion)
    return how["position"] >= FOLLOWS and how["position"] >= how["velocity"] + SURE


def _motions(group: Sequence[Field]) -> list[Field]:
    """The columns of an axis that may be its place."""
    motions = [f for f in group if not f.says & {"command", "operator", "force"} and f.says != {"speed"}]
    return [f for f in motions if "speed" not in f.says] or motions


def _completed(groups: Mapping[str, list[Field]], fields: Sequence[Field]) -> dict[str, list[Field]]:
    """The groups; two of which one lacks the motion and one the command are one axis if they alone have most words in common.

    ``i_valve_boom`` and ``wire_boom`` are of one axis, whatever ``i`` is.
    """
    says = {words: frozenset().union(*(f.says for f in group)) - {"operator"} for words, group in groups.items()}
    given = {words for words, group in groups.items() if not _motions(group) and says[words] & {"command", "force"}}
    moved = {words for words, group in groups.items() if "command" not in says[words] and any(f.says for f in _motions(group))}
    common = {
        (one, other): len({*one.split("_")} & {*other.split("_")} - {""})
        for one, other in itertools.product(given, moved)
        if "command" in says[one] or "force" not in says[other]
    }
    if len(given) == len(moved) == 1 and not any(
        _motions(group) and "command" in says[words] for words, group in groups.items()
    ):
        common = dict.fromkeys(itertools.product(given, moved), 1)  # one axis, whatever its columns are called
    found, partner = dict(groups), dict[str, str]()
    for (one, other), count in common.items():
        others = [size for pair, size in common.items() if pair != (one, other) and (one in pair or other in pair)]
        if count > max(others, default=0):
            partner[other] = one
    for other, one in partner.items():
        words = "_".join(word for word in other.split("_") if word in one.split("_"))
        joined = [*found.pop(one), *found.pop(other)]
        found[words] = [*found.get(words, []), *joined]
    order = {field.label: k for k, field in enumerate(fields)}
    return dict(sorted(found.items(), key=lambda item: min(order[field.label] for field in item[1])))


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
    gap, parts = np.full(round(MAX_DELAY_S * RATE_HZ) + 2, np.nan), [*_parts(command, motion, RATE_HZ, held)]
    if not parts:
        return gap, gap
    u, x = (np.concatenate([part for pair in zip(column, [gap] * len(parts), strict=True) for part in pair])
            for column in zip(*parts, strict=True))  # fmt: skip
    return u, x


def _parts(command: Field, motion: Field, rate: float, held: bool = True) -> Iterator[tuple[Array, Array]]:
    """Command and motion on an even grid of ``rate`` [Hz], (n,) each: of each recording, between the pauses of the motion."""
    for one, other in itertools.product(command.series, motion.series):
        given, known = np.isfinite(one.values), np.isfinite(other.values)
        if one.recording != other.recording or np.count_nonzero(given) < 2 or np.count_nonzero(known) < 2:
            continue
        at, values, time, places = one.time[given], one.values[given], other.time[known], other.values[known]
        steps = np.diff(time)
        pauses = np.flatnonzero(steps > max(PAUSE_STEPS * float(np.median(steps)), PAUSE_S)) + 1
        for piece in np.split(np.arange(len(time)), pauses):
            begin = max(at[0], time[piece[0]])
            grid = np.arange(begin, min(at[-1], time[piece[-1]], at[0] + MAX_SECONDS), 1.0 / rate)
            if len(grid):
                before = values[np.clip(np.searchsorted(at, grid, "right") - 1, 0, len(values) - 1)]
                yield before if held else np.interp(grid, at, values), np.interp(grid, time, places)


def _force_scales(commands: Mapping[str, Field], answers: Answers) -> dict[str, float]:
    """Force [N or N·m] for each 1 of the columns that state no unit: masses and friction that are found have this scale."""
    unknown = {name: command for name, command in commands.items() if command.unit is None}
    if not unknown:
        return {}
    why = f"{_ranges([*unknown], unknown)}: no unit of force is stated; N, or N·m of an angle, for each 1 of it"
    scales = _of_all_or_each("force_scale", dict.fromkeys(unknown, "1"), Question("force_scale", "1", why), answers)
    return {name: number(scale, Positive, f"--set {name}.force_scale") for name, scale in scales.items()}


def _axis(name: str, pair: _Pair, actuation: str, drives: str, unit: str, scale: float, answers: Answers) -> AxisDraft:
    command, motion, notes = pair.command, pair.motion, pair.notes
    command_unit, zero, span, sign, gain, inertia = None, 0.0, 1.0, 1, 1.0, math.nan
    factor = unit_factor(unit)
    if actuation == "velocity":
        zero, span, sign, gain = _valve(name, pair, answers)
        gain = max(factor * gain, SMALLEST)
    elif actuation == "position":
        command_unit = command.unit or unit
    else:
        command_unit = command.unit or ("N" if unit in LENGTHS else "N·m")
        inertia = _inertia(command, motion, scale * unit_factor(command_unit), factor, notes)
        if command.unit is None:
            notes["span"] = f"no unit stated: {scale:g} {command_unit} for each 1 of it; masses and friction have this scale"
    values = motion.values * factor
    notes["ends"] = "the range that the logs contain: where it is not the end stops, widen it"
    if actuation == "position":
        values = np.concatenate([values, command.values * unit_factor(command_unit or unit)])
        notes["ends"] = "the range of commands and motion in the logs: where it is not the end stops, widen it"
    ends = float(values.min()), float(values.max())
    return AxisDraft(
        name, command, motion, actuation, drives, zero, span, sign, unit, command_unit, gain, inertia, ends, notes, scale=scale
    )


def unit_factor(unit: str) -> float:
    """SI value of a unit of motion; also of counts, as ``4096/turn``."""
    counts, per_turn, _ = unit.partition("/turn")
    return 2.0 * math.pi / float(counts) if per_turn else si_factor(unit)[0]


def _inertia(command: Field, motion: Field, force: float, length: float, notes: dict[str, str]) -> float:
    """Moving mass or inertia of a force axis; one, which is said to be assumed, where the recordings do not show it.

    Args:
        force, length: units of command and motion [SI].
    """
    rate = _fine_rate(command)
    found = moved_mass([(force * u, length * x) for u, x in _parts(command, motion, rate, held=False)], rate)
    if not found > 0.0:
        notes["inertia"] = "assumed: these logs do not show it"
        return 1.0
    notes["inertia"] = "from force and acceleration, beside friction and weight"
    return found


def _likely(command: Field, how: Mapping[str, float]) -> str:
    """What a command is by its name, and by what follows it."""
    if "force" in command.says:
        return "force"
    follows = how["position"] >= max(how["velocity"], FOLLOWS) or how["position"] >= how["velocity"] + SURE
    return "position" if follows else "velocity"


def _actuations(pairs: Mapping[str, _Pair], answers: Answers, kind: str | None) -> dict[str, str]:
    """What each command is: a speed, a position or a force. Those that neither names nor data decide are asked together."""
    if kind is not None:
        return dict.fromkeys(pairs, KINDS[kind])
    found, unsure = dict[str, str](), dict[str, str]()
    for name, pair in pairs.items():
        how, fit = pair.how, pair.fit
        likely = found[name] = _likely(pair.command, how)
        if likely == "force":
            pair.notes["actuation"] = f"{pair.command.label} is a force or torque by its name"
            continue
        shown = f"correlation of the command with the speed {how['velocity']:.2f}, with the position {how['position']:.2f}"
        slow = likely == "velocity" and fit is not None and fit.lag >= SLOW_S
        if slow and fit is not None:
            shown += f", full speed after {3.0 * fit.lag:.2g} s as of a mass under a force"
            found[name] = "force"
        pair.notes["actuation"] = shown
        weak = likely == "position" and how["position"] < FOLLOWS
        if abs(how["position"] - how["velocity"]) < SURE or slow or weak:
            unsure[name] = f"{pair.command.label}: {shown}"
    if unsure:
        usual = Counter(found[name] for name in unsure).most_common(1)[0][0]
        choices = ("velocity", "position", "force")
        question = Question("actuation", usual, listed([*unsure.values()], 4), choices)
        found |= _of_all_or_each("actuation", {name: found[name] for name in unsure}, question, answers)
    return found


def _units(pairs: Mapping[str, _Pair], actuations: Mapping[str, str], answers: Answers) -> dict[str, tuple[str, str, str]]:
    """What each command drives, the unit of its motion, and where that is from; motions without a unit are decided together."""
    found = {}
    unknown = {name: pair.motion for name, pair in pairs.items() if pair.motion.unit is None}
    forms = {name: _form(name, pair, actuations[name]) for name, pair in pairs.items() if name in unknown}
    valves = [name for name in unknown if actuations[name] == "velocity"]
    for name in (name for name in valves if forms[name]):
        why = f"{_ranges([name], unknown)}: by its name"
        forms[name] = answers.of(Question(f"{name}.drives", forms[name], why, ("cylinder", "joint")), sure=True)
    plain = {name: "joint" if _below_zero(unknown[name]) else "cylinder" for name in valves if not forms[name]}
    if plain:
        usual = Counter(plain.values()).most_common(1)[0][0]
        why = f"{_ranges([*plain], unknown)}: lengths of cylinders, or angles of joints"
        forms |= _of_all_or_each("drives", plain, Question("drives", usual, why, ("cylinder", "joint")), answers)
    groups = (
        ("unit", [name for name in unknown if forms[name] == "cylinder"]),
        ("angle_unit", [name for name in unknown if forms[name] == "joint"]),
        ("position_unit", [name for name in unknown if not forms[name]]),
    )
    for key, names in groups:
        if not names:
            continue
        most = max(float(np.abs(unknown[name].values).max()) for name in names)
        whole = all(bool(np.all(unknown[name].values % 1.0 == 0.0)) for name in names)
        ranges = _ranges(names, unknown)
        likely, choices, sure = _likely_unit(key, most, whole)
        question = Question(key, likely, f"{ranges}; the unit is not stated", choices)
        of_all = answers.of(question, sure)
        for name in names:
            every = Question(f"{name}.unit", of_all, question.why, (*LENGTHS, *ANGLE_UNITS))
            unit = answers.of(every, sure=True)
            cylinder = name in valves and (forms[name] == "cylinder" or unit in LENGTHS)
            found[name] = "cylinder" if cylinder else "joint", unit, f"not stated; {ranges}"
    for name, pair in pairs.items():
        if pair.motion.unit is not None:
            drives = "cylinder" if pair.motion.unit in LENGTHS and actuations[name] == "velocity" else "joint"
            found[name] = drives, pair.motion.unit, "stated in the file"
    return found


def _form(name: str, pair: _Pair, actuation: str) -> str:
    """Whether names and values show a length (``cylinder``) or an angle (``joint``); empty where they do not."""
    words = {*words_of(f"{name} {pair.motion.label} {pair.command.label}")}
    angle, straight = bool(words & ANGLES), bool(words & STRAIGHT)
    if actuation == "velocity":
        angle |= bool(words & {"joint", "joints", "gelenk"})
    return "" if angle == straight else "joint" if angle else "cylinder"


def _below_zero(motion: Field) -> bool:
    """Whether it reaches below zero, as no cylinder does that is measured from its retracted end."""
    low, high = float(motion.values.min()), float(motion.values.max())
    return low < -BELOW * (high - low)


def _of_all_or_each(quantity: str, likely: Mapping[str, str], question: Question, answers: Answers) -> dict[str, str]:
    """What is true of each axis: its own answer (``boom.drives``), else that of all (``drives``), else what is ``likely``."""
    of_all = answers.of(question)
    given = question.key in answers.given
    return {
        name: answers.of(Question(f"{name}.{quantity}", of_all if given else own, question.why, question.choices), sure=True)
        for name, own in likely.items()
    }


def _likely_unit(key: str, most: float, whole: bool) -> tuple[str, tuple[str, ...], bool]:
    """The likely unit of motions up to ``most``, the choices, and whether it is sure; ``whole``: of whole numbers only."""
    lengths = "m" if most <= METRES else "mm" if most >= MILLIMETRES else "cm"
    counts = whole and most > DEGREES
    angles = "rad" if most <= RADIANS else COUNTS if counts else "deg"
    if key == "unit":
        return lengths, LENGTHS, most <= METRES
    if key == "angle_unit":
        return angles, ANGLE_UNITS, most <= HALF_TURN or UNSURE < most <= DEGREES
    return angles, (*ANGLE_UNITS, *LENGTHS), False


def _ranges(names: Sequence[str], motions: Mapping[str, Field]) -> str:
    shown = [f"{motions[name].label} {motions[name].values.min():.4g} … {motions[name].values.max():.4g}" for name in names]
    return listed(shown, 4)


def _valve(name: str, pair: _Pair, answers: Answers) -> tuple[float, float, int, float]:
    """Of a valve axis: neutral and span of its command [raw], sign, and speed at full command [unit of the motion / s]."""
    command, motion, notes = pair.command, pair.motion, pair.notes
    found = pair.fit or _fitted(command, motion)
    known = command.values
    low, high = float(known.min()), float(known.max())
    zero = _neutral(name, low, high, found, answers, notes)
    span = max(high - zero, zero - low)
    if zero == 0.0 and low >= -UNIT_COMMAND and high <= UNIT_COMMAND:
        span = 1.0
    likely = min(SCALES, key=lambda scale: abs(scale - span))
    if zero == 0.0 and abs(likely - span) <= NEAR * likely:
        span = likely
    if (zero, span) != (0.0, 1.0):
        notes["span"] = f"from neutral to the largest command ({low:.4g} … {high:.4g})"
    if found is None:
        notes["gain"] = "the largest speed: the motion is too short for more"
        moved = np.abs(speed(_together(command, motion)[1], RATE_HZ))
        return zero, span, 1, float(np.nanmax(moved)) if np.isfinite(moved).any() else 0.0
    sign = -1 if found.speeds[-1] < found.speeds[0] else 1
    full = zero + sign * span
    beyond = max(low - full, full - high) > NEAR * span
    notes["gain"] = f"speed at the command {full:.4g}{f', beyond the logs ({low:.4g} … {high:.4g})' if beyond else ''}: "
    notes["gain"] += f"{found.windows} windows, delay {found.delay:.2f} s, lag {found.lag:.2f} s"
    return zero, span, sign, abs(found.at(full, zero))


def _neutral(
    name: str, low: float, high: float, found: Characteristic | None, answers: Answers, notes: dict[str, str]
) -> float:
    """The raw command at which the axis rests."""
    if found is None:
        return 0.0 if low <= 0.0 <= high else 0.5 * (low + high)
    zero, share = found.rest
    if math.isfinite(zero):
        notes["zero"] = f"where the axis rests most ({share:.0%} of its rest)"
        return 0.0 if low < 0.0 < high and abs(zero) < NEAR * (high - low) else zero
    # Nothing rests: a usual neutral near to where the speed changes its sign.
    width = high - low
    crossing = found.crossing if math.isfinite(found.crossing) else 0.5 * (low + high)
    usual = min(NEUTRALS, key=lambda value: abs(value - crossing))
    likely = usual if abs(usual - crossing) <= ASIDE * width and low <= usual <= high else float(f"{crossing:.5g}")
    sure = abs(likely - crossing) <= 0.5 * NEAR * width and likely == usual
    notes["zero"] = f"the motion changes its direction at {crossing:.5g}, and never rests at one command"
    answer = answers.of(Question(f"{name}.neutral", f"{likely:g}", f"{name}: {notes['zero']}"), sure)
    try:
        return float(answer)
    except ValueError:
        raise SettingsError(
            f"--set {name}.neutral={answer}", "no number", f"the raw command at rest, {low:g} … {high:g}"
        ) from None
