"""The axes that the columns show: how each is actuated, in which units its columns are, and its values in machine.toml."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.datasets.drafting.axis_values import Characteristic, moved_mass
from sysid.datasets.drafting.fields import Answers, Field, Question
from sysid.datasets.drafting.pairs import (
    FOLLOWS,
    RATE_HZ,
    SURE,
    AxisPair,
    as_valve,
    axis_pairs,
    fine_rate,
    likely_actuation,
    opposed,
    parts_of,
    together,
)
from sysid.datasets.quality.responses import speed
from sysid.datasets.words import ANGLES, STRAIGHT, words_of
from sysid.errors import SettingsError
from sysid.names import listed
from sysid.numbers import Positive, number
from sysid.units import si_factor

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
#: A command within this range is a share of the full one already.
UNIT_COMMAND = 1.05
#: Usual full scales of a command; one is taken if the largest command is within this share of it.
SCALES, NEAR = (1.0, 100.0, 127.0, 255.0, 500.0, 1000.0, 1023.0, 2047.0, 4095.0, 32767.0), 0.02
#: Usual raw commands at rest; one is proposed within this share of the range of the command from where the motion reverses.
NEUTRALS, ASIDE = (0.0, 0.5, 2.5, 5.0, 7.5, 50.0, 127.0, 128.0, 512.0, 1500.0, 2048.0, 32768.0), 0.06
#: A valve is faster than this [s]; a mass under a force is slower.
SLOW_S = 0.45

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
    pairs, left = axis_pairs(fields, answers, kind)
    without = opposed(pairs, answers, kind)
    if without:
        kept = [replace(f, series=tuple(one for one in f.series if one.recording not in without)) for f in fields]
        pairs, left = axis_pairs([f for f in kept if f.series], answers, kind)
    actuations = _actuations(pairs, answers, kind)
    units = _units(pairs, actuations, answers)
    scales = _force_scales({name: pair.command for name, pair in pairs.items() if actuations[name] == "force"}, answers)
    unstated = {name: pair for name, pair in pairs.items() if pair.motion.unit is None and actuations[name] == "velocity"}
    other = _other_units(unstated, units, answers)
    found = []
    for name, pair in pairs.items():
        drives, unit, pair.notes["unit"] = units[name]
        its = other if name in unstated else {}
        scaled = pair if not its else replace(pair, motion=_in_one_unit(pair.motion, unit, its), fit=None)
        axis = _axis(name, scaled, actuations[name], drives, unit, scales.get(name, 1.0), answers)
        found.append(replace(axis, motion=pair.motion, units=its))
    return found, left, without


def _other_units(pairs: Mapping[str, AxisPair], units: Mapping[str, tuple[str, str, str]], answers: Answers) -> dict[str, str]:
    """Recordings whose motions are in a coarser unit of length: most of them are smaller and slower by its ratio."""
    votes = Counter(vote for name, pair in pairs.items() for vote in _coarser(pair, units[name][1]))
    found: dict[str, str] = {}
    for (recording, coarser, ratio), count in votes.items():
        if 2 * count > len(pairs):
            labels = listed([pair.motion.label for pair in pairs.values()], 3)
            why = f"{labels} in {recording}: {ratio:.0f} times smaller and slower than in the others"
            found[recording] = answers.of(Question(f"unit.{recording}", coarser, why, LENGTHS))
    return found


def _coarser(pair: AxisPair, unit: str) -> Iterator[tuple[str, str, float]]:
    """Recording, unit and ratio where a motion is smaller and slower by the ratio of a coarser unit."""
    if unit not in LENGTHS:
        return
    command, motion = pair.command, pair.motion
    speeds, places = dict[str, float](), dict[str, float]()
    known = {one.recording: one.values[np.isfinite(one.values)] for one in command.series}
    whole = float(np.ptp(command.values))
    driven = {recording for recording, values in known.items() if len(values) and np.ptp(values) >= DRIVEN * whole}
    for one in (one for one in motion.series if one.recording in driven):
        moved = speed(together(command, replace(motion, series=(one,)))[1], RATE_HZ)
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


def _force_scales(commands: Mapping[str, Field], answers: Answers) -> dict[str, float]:
    """Force [N or N·m] for each 1 of the columns that state no unit: masses and friction that are found have this scale."""
    unknown = {name: command for name, command in commands.items() if command.unit is None}
    if not unknown:
        return {}
    why = f"{_ranges([*unknown], unknown)}: no unit of force is stated; N, or N·m of an angle, for each 1 of it"
    scales = _of_all_or_each("force_scale", dict.fromkeys(unknown, "1"), Question("force_scale", "1", why), answers)
    return {name: number(scale, Positive, f"--set {name}.force_scale") for name, scale in scales.items()}


def _axis(name: str, pair: AxisPair, actuation: str, drives: str, unit: str, scale: float, answers: Answers) -> AxisDraft:
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
    rate = fine_rate(command)
    found = moved_mass([(force * u, length * x) for u, x in parts_of(command, motion, rate, held=False)], rate)
    if not found > 0.0:
        notes["inertia"] = "assumed: these logs do not show it"
        return 1.0
    notes["inertia"] = "from force and acceleration, beside friction and weight"
    return found


def _actuations(pairs: Mapping[str, AxisPair], answers: Answers, kind: str | None) -> dict[str, str]:
    """What each command is: a speed, a position or a force. Those that neither names nor data decide are asked together."""
    if kind is not None:
        return dict.fromkeys(pairs, KINDS[kind])
    found, unsure = dict[str, str](), dict[str, str]()
    for name, pair in pairs.items():
        how, fit = pair.how, pair.fit
        likely = found[name] = likely_actuation(pair.command, how)
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


def _units(pairs: Mapping[str, AxisPair], actuations: Mapping[str, str], answers: Answers) -> dict[str, tuple[str, str, str]]:
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


def _form(name: str, pair: AxisPair, actuation: str) -> str:
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


def _valve(name: str, pair: AxisPair, answers: Answers) -> tuple[float, float, int, float]:
    """Of a valve axis: neutral and span of its command [raw], sign, and speed at full command [unit of the motion / s]."""
    command, motion, notes = pair.command, pair.motion, pair.notes
    found = pair.fit or as_valve(command, motion)
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
        moved = np.abs(speed(together(command, motion)[1], RATE_HZ))
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
