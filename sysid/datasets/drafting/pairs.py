"""The columns that are one axis: its command, and the motion that answers it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.datasets.checks.measures import LEAST_STRENGTH
from sysid.datasets.chunked import Array
from sysid.datasets.drafting.axis_values import Characteristic, characteristic
from sysid.datasets.drafting.fields import MAX_SECONDS, Answers, Field, Question
from sysid.datasets.quality.responses import MAX_DELAY_S, correlation, speed
from sysid.errors import SettingsError, nearest
from sysid.machine.description import RESERVED
from sysid.names import listed, slug

#: Rate at which columns are compared [Hz].
RATE_HZ = 20.0
#: Least correlation of a command and its motion; of a commanded position; difference at which one of two kinds is sure.
ANSWERS, FOLLOWS, SURE = 0.2, 0.9, 0.1
#: Correlation of a motion and the integral of its command above which it may be computed from it: a real axis answers later.
COMPUTED = 0.9995
#: What an answer may assign a column to, and what its name then says.
ASSIGNED = {"command": "command", "motion": "measured"}
#: A pause of a motion is longer than this multiple of its median step, and than this [s].
PAUSE_STEPS, PAUSE_S = 4.0, 0.2
#: Rate at which the speeds of a valve axis are fitted [Hz], and the rows of that.
FINE_HZ, MAX_ROWS = 100.0, 2.0**18
#: The answer that leaves no recording out.
NOTHING = "none"


@dataclass(frozen=True)
class AxisPair:
    """Command and motion of an axis, how one follows the other (correlations), and as a valve (None: too short)."""

    command: Field
    motion: Field
    how: Mapping[str, float]
    fit: Characteristic | None
    notes: dict[str, str] = field(default_factory=dict)


def axis_pairs(fields: Sequence[Field], answers: Answers, kind: str | None) -> tuple[dict[str, AxisPair], list[str]]:
    """Axis → its command and motion; and why other columns are left out."""
    groups: dict[str, list[Field]] = {}
    for each in _assigned(fields, answers):
        groups.setdefault(each.axis, []).append(each)
    groups = _completed(groups, fields)
    pairs, left = dict[str, AxisPair](), list[str]()
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
        valve = likely_actuation(command, how) == "velocity" and kind in (None, "hydraulic")
        pairs[name] = AxisPair(command, motion, how, as_valve(command, motion) if valve else None)
    return pairs, left


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


def _motions(group: Sequence[Field]) -> list[Field]:
    """The columns of an axis that may be its place."""
    motions = [f for f in group if not f.says & {"command", "operator", "force"} and f.says != {"speed"}]
    return [f for f in motions if "speed" not in f.says] or motions


def _is_setpoint(field: Field, motion: Field) -> bool:
    """Whether what is a speed by its name (``qd``) is the desired position: the motion follows it, and its speed does not."""
    how = _compared(field, motion)
    return how["position"] >= FOLLOWS and how["position"] >= how["velocity"] + SURE


def _compared(command: Field, motion: Field) -> dict[str, float]:
    """How well the speed, and the position, follow the command: correlations."""
    u, x = together(command, motion)
    delays = round(MAX_DELAY_S * RATE_HZ)
    return {"velocity": abs(correlation(u, speed(x, RATE_HZ), delays)), "position": abs(correlation(u, x, delays))}


def _integrated(command: Field, motion: Field) -> float:
    """Correlation of the way in a second with the integral of the command, without a delay."""
    areas = [
        replace(one, values=np.concatenate([[0.0], np.cumsum(np.nan_to_num(one.values[:-1]) * np.diff(one.time))]))
        for one in command.series
    ]
    area, place = together(replace(command, series=tuple(areas)), motion, held=False)
    rows = round(RATE_HZ)
    way, meant = place[rows:] - place[:-rows], area[rows:] - area[:-rows]
    known = np.isfinite(way) & np.isfinite(meant)
    if np.count_nonzero(known) < 2 * rows or not (np.ptp(way[known]) > 0.0 and np.ptp(meant[known]) > 0.0):
        return 0.0
    # A neutral that is not zero adds the same to every second.
    return abs(float(np.corrcoef(way[known], meant[known])[0, 1]))


def _measured(name: str, command: Field, motion: Field, strength: float) -> Question:
    why = f"{motion.label} is the integral of {command.label} (correlation {strength:.5f}): measured, or computed from it"
    return Question(f"{name}.measured", "no", why, ("yes", "no"))


def likely_actuation(command: Field, how: Mapping[str, float]) -> str:
    """What a command is by its name, and by what follows it."""
    if "force" in command.says:
        return "force"
    follows = how["position"] >= max(how["velocity"], FOLLOWS) or how["position"] >= how["velocity"] + SURE
    return "position" if follows else "velocity"


def opposed(pairs: Mapping[str, AxisPair], answers: Answers, kind: str | None) -> dict[str, str]:
    """Recordings in which a motion goes against its command, which it follows in most others: there it hardly acts.

    A force is followed by neither place nor speed: above its resonance a pendulum moves against the torque that drives it.
    """
    found = dict[str, str]()
    for pair in (pair for pair in pairs.values() if not (kind == "force" or (kind is None and "force" in pair.command.says))):
        quantity = max(pair.how, key=lambda key: pair.how[key])
        least, delays = LEAST_STRENGTH[quantity], round(MAX_DELAY_S * RATE_HZ)
        follows = dict[str, float]()
        for one in pair.motion.series:
            u, x = together(pair.command, replace(pair.motion, series=(one,)))
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


def as_valve(command: Field, motion: Field) -> Characteristic | None:
    """The motion as that of a valve."""
    rate = fine_rate(command)
    return characteristic([*parts_of(command, motion, rate)], rate)


def fine_rate(command: Field) -> float:
    """Rate of the grid on which an axis is fitted [Hz]."""
    return min(FINE_HZ, MAX_ROWS / max(sum(float(np.ptp(one.time)) for one in command.series), 1.0))


def together(command: Field, motion: Field, held: bool = True) -> tuple[Array, Array]:
    """Command (held between its samples) and motion of all recordings on one even grid, (n,) each; NaN between recordings."""
    gap, parts = np.full(round(MAX_DELAY_S * RATE_HZ) + 2, np.nan), [*parts_of(command, motion, RATE_HZ, held)]
    if not parts:
        return gap, gap
    u, x = (np.concatenate([part for pair in zip(column, [gap] * len(parts), strict=True) for part in pair])
            for column in zip(*parts, strict=True))  # fmt: skip
    return u, x


def parts_of(command: Field, motion: Field, rate: float, held: bool = True) -> Iterator[tuple[Array, Array]]:
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
