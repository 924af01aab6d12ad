"""Why an effect was named and why the others were not, in words that need no statistics."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from sysid.gap.result import Alternative, ComparedModel, NamedEffect
from sysid.reports import display, words

#: ``backlash(slew, drive)``: effect, target and whatever else tells two instances apart; ``~`` marks what is only refitted.
LABEL = re.compile(r"(?P<name>\w+)\((?P<target>[\w.]+)(?:,\s*(?P<rest>[^)]*))?\)(?P<refitted> ~)?")
_EVIDENCE = re.compile(r"ΔBIC (?P<bic>-?[\d.]+)")
#: A rival with less than this multiple of the error is hardly worse on unseen recordings.
HARDLY, CLEARLY = 1.05, 1.5


@dataclass(frozen=True)
class Loss:
    """An effect that lost: ``times`` is its error on unseen recordings over that of the winner (NaN where not comparable)."""

    title: str
    target: str
    times: float
    why: str


def label_of(text: str) -> tuple[str, str, str, bool]:
    """``(effect, target, rest, refitted)`` of a candidate's label."""
    match = LABEL.fullmatch(text)
    if match is None:
        return text, "", "", False
    return match["name"], match["target"], match["rest"] or "", bool(match["refitted"])


def holds(row: ComparedModel, name: str, target: str) -> bool:
    """Whether a fitted set has the effect as a name (not merely refitted beside others)."""
    return any(label_of(text)[:2] == (name, target) and not label_of(text)[3] for text in row.effects)


def least_error(rows: Iterable[ComparedModel]) -> float:
    """Smallest error on unseen recordings, in noise floors; NaN where nothing was fitted."""
    errors = [row.selection_rmse for row in rows if math.isfinite(row.selection_rmse)]
    return min(errors, default=math.nan)


def losses(effect: NamedEffect, candidates: Sequence[ComparedModel]) -> list[Loss]:
    """Every alternative of a named effect, the nearest rival first."""
    stages = {(row.stage, row.target) for row in candidates if holds(row, effect.name, effect.target)}
    rows = [row for row in candidates if (row.stage, row.target) in stages]
    winner = least_error(row for row in rows if holds(row, effect.name, effect.target))
    found = []
    for other in effect.alternatives:
        without = [row for row in rows if not holds(row, effect.name, effect.target)]
        times = least_error(row for row in without if holds(row, other.name, other.target)) / winner
        title, target = words.effect_title(other.name), words.owner_name(other.target)
        found.append(Loss(title, target, times, _why(times, other)))
    return sorted(found, key=lambda loss: loss.times if math.isfinite(loss.times) else math.inf)


def _why(times: float, other: Alternative) -> str:
    if other.rejected_by.startswith("predicts"):
        return other.rejected_by
    match = _EVIDENCE.search(other.rejected_by)
    if match is None and not math.isfinite(times):
        return other.rejected_by
    if times >= CLEARLY:
        return f"its best fit leaves {display.ratio(times)} the error on recordings that it was not fitted to"
    if times >= HARDLY:
        return f"its best fit leaves {display.percent(times - 1.0)} more error on recordings that it was not fitted to"
    if match is None:
        return other.rejected_by
    against = f"evidence ΔBIC {match['bic']}, where 10 is strong"
    if math.isfinite(times):
        return f"as near over whole recordings, but wrong from moment to moment ({against})"
    return f"wrong from moment to moment ({against})"


def fate(row: ComparedModel, best: float, named: Sequence[tuple[str, str]]) -> tuple[str, bool]:
    """What became of a fitted set, and whether it won; ``best`` is the least error at its stage."""
    ordinary = {label_of(text)[:2] for text in row.effects if not label_of(text)[3]}
    times = row.selection_rmse / best if best > 0.0 else math.nan
    if row.verdict.startswith(("rejected", "no effect", "named", "kept")):
        return row.verdict, row.verdict.startswith(("named", "kept"))
    if row.verdict.endswith("nats worse"):
        return f"predicts {row.verdict}", False
    if ordinary and ordinary <= set(named) and times < 1.02 and row.verdict.startswith("drops "):
        name, target, _, _ = label_of(row.verdict.removeprefix("drops "))
        what = name.replace("_", " ") + (f" of the {words.owner_name(target)}" if target else "")
        return f"kept: no worse without {what}", True
    if ordinary and ordinary <= set(named) and times < 1.02:
        return "explains it", True
    if times >= CLEARLY:
        return f"leaves {display.ratio(times)} the error of the best", False
    if times >= HARDLY:
        return f"leaves {display.percent(times - 1.0)} more error than the best", False
    if math.isfinite(times):
        return "about as good, but needs more to say the same" if ordinary - set(named) else "about as good", False
    return "could not be fitted", False


def confidence(effect: NamedEffect, candidates: Sequence[ComparedModel]) -> list[str]:
    """How sure a name and its values are."""
    said = []
    others = losses(effect, candidates)
    if others:
        nearest = others[0]
        text = f"{len(others)} other effect{'s were' if len(others) > 1 else ' was'} tried in its place"
        if math.isfinite(nearest.times) and nearest.times >= HARDLY:
            text += (
                f"; the nearest, {nearest.title.lower()}, leaves {display.ratio(nearest.times)} the error on unseen recordings"
            )
        said.append(text + ".")
    width = relative_width(effect)
    if math.isfinite(width):
        said.append(f"Its value{'s are' if len(effect.given) > 1 else ' is'} known to within ±{_percent(width)}.")
    return said


def relative_width(effect: NamedEffect) -> float:
    """Half the widest 95 % interval of a parameter over its value; NaN where that means nothing (a value near zero)."""
    widths = []
    for name, value in effect.given.items():
        low, high = effect.interval95.get(name, (math.nan, math.nan))
        if isinstance(value, (list, tuple)) or isinstance(low, (list, tuple)) or value == 0.0:
            return math.nan
        widths.append(0.5 * (float(high) - float(low)) / abs(float(value)))
    widest = max(widths, default=math.nan)
    return widest if widest < 1.0 else math.nan


def _percent(share: float) -> str:
    return f"{display.number(100.0 * share, 2)}{display.NARROW_SPACE}%"
