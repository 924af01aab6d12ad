"""Words for reports and the console: stages, verdicts, signals, named effects, and the reasons why an effect was named and its
alternatives were rejected.
"""

from __future__ import annotations

import math
import re
import string
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sysid import display
from sysid.display import owner_name as owner_name  # names of owners and signals, for those that take words from here
from sysid.display import signal_name as signal_name
from sysid.effects import BY_NAME
from sysid.effects.wording import sentences_of, title_of
from sysid.machine import Machine

if TYPE_CHECKING:
    from sysid.gap.result import ComparedModel, NamedEffect

#: Stage → what is compared, in the order of the signal chain.
STAGES: dict[str, tuple[str, str]] = {
    "command": ("Command → actuator", "driven by the recorded command"),
    "force": ("Force → motion", "force that the measured motion needs"),
    "joint": ("Actuator → joint", "driven by the measured actuator"),
    "end_effector": ("Joints → tip", "driven by the measured joints"),
    "tool": ("Tip → tool", "driven by the measured tip"),
}

ADVICE = {
    "no_gap": "No effect was added. Effects that the recordings do not excite may still be present; they are listed below.",
    "unnamed": "No effect was named. The properties of the remaining error are listed below.",
    "ambiguous": "No effect was selected. A recording that distinguishes them is described under “What to record next”.",
    "insufficient_excitation": "The recordings that are needed are described under “What to record next”.",
}


def effect_title(name: str, target: str = "", machine: Machine | None = None) -> str:
    """The title of an effect, as its file gives it for actuation and drive of the axis ``target``."""
    if name not in BY_NAME:
        return name.replace("_", " ").capitalize()
    return title_of(BY_NAME[name], target, machine)


def effect_place(name: str, target: str, machine: Machine) -> str:
    """``Dead time of boom``; ``Sensor bias of boom.joint``."""
    return f"{effect_title(name, target, machine)} of {owner_name(target)}"


def tie_text(tie: Iterable[tuple[str, str]], machine: Machine) -> str:
    """The effects that recordings cannot distinguish: ``Backlash of boom or Sensor scale of boom.joint``."""
    return " or ".join(effect_place(name, target, machine) for name, target in tie)


def effect_sentence(
    name: str, target: str, parameters: Mapping[str, str], beside: Collection[str] = (), machine: Machine | None = None
) -> str:
    """One sentence about a named effect.

    Args:
        parameters: already formatted with their units.
        beside: other effects named on the same target.
    """
    values = {"target": owner_name(target), **parameters}
    effect = BY_NAME.get(name)
    special = [text for other, text in effect.beside.items() if other in beside] if effect else []
    for template in (*special, *(sentences_of(effect, target, machine) if effect else ())):
        if {field for _, field, _, _ in string.Formatter().parse(template) if field} <= set(values):
            return template.format(**values)
    listed = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in parameters.items())
    return f"{effect_title(name, target, machine)} of the {values['target']}: {listed}."


def stage_name(stage: str) -> str:
    return STAGES[stage][0] if stage in STAGES else stage.replace("_", " ").capitalize()


def localised(places: list[str]) -> str:
    """The places of the stages with errors, as a sentence."""
    listed = ", ".join(places[:4]) + (f" and {len(places) - 4} more" if len(places) > 4 else "")
    return f"Simulation and machine disagree at: {listed}."


def remainder_unit(stage: str, target: str, machine: Machine, units: Mapping[str, str]) -> str:
    """Unit of the unnamed error of a stage: that of the signal that the stage predicts."""
    if stage == "free_run":
        return units.get(target) or machine.expected_unit(target) or "1"
    if target not in machine.axis_names:
        return units.get(f"{target}.x", "m")
    if stage == "force":
        return units.get(f"{target}.command", "N")
    if stage == "joint":
        return units.get(f"{target}.joint", "rad")
    return units.get(machine.axis(target).driven, "m")


#: ``backlash(slew, drive) [width]``: effect, target, side, and the parameters of a form that is not the simplest.
LABEL = re.compile(r"(?P<name>\w+)\((?P<target>[\w.]+)(?:,\s*(?P<rest>[^)]*))?\)(?: \[(?P<form>[^\]]*)\])?")
#: Ratio of errors on selection recordings from which an alternative is worse, and clearly worse.
WORSE, CLEARLY_WORSE = 1.05, 1.5


@dataclass(frozen=True)
class RejectedEffect:
    """A rejected alternative; ``times`` is its error on selection recordings over that of the named effect, or NaN."""

    title: str
    target: str
    times: float
    why: str


def label_of(text: str) -> tuple[str, str, str]:
    """``(effect, target, qualifiers)`` of a candidate's label."""
    match = LABEL.fullmatch(text)
    return (text, "", "") if match is None else (match["name"], match["target"], _qualifiers(match))


def with_titles(text: str, machine: Machine) -> str:
    """The text with ``Servo lag of pitch`` in the place of the label ``first_order_lag(pitch)``."""

    def title(match: re.Match[str]) -> str:
        if match["name"] not in BY_NAME:
            return match[0]
        qualified = f" ({match['form']})" if match["form"] else ""
        return effect_place(match["name"], match["target"], machine) + qualified

    return LABEL.sub(title, text)


def _qualifiers(match: re.Match[str]) -> str:
    return ", ".join(match[key] for key in ("rest", "form") if match[key])


def holds(row: ComparedModel, name: str, target: str) -> bool:
    """Whether a fitted set contains the effect."""
    return any(label_of(text)[:2] == (name, target) for text in row.effects)


def least_error(rows: Iterable[ComparedModel]) -> float:
    """Smallest error on selection recordings, in noise floors; NaN if nothing was fitted."""
    errors = [row.selection_rmse for row in rows if math.isfinite(row.selection_rmse)]
    return min(errors, default=math.nan)


def rejected(effect: NamedEffect, candidates: Sequence[ComparedModel], machine: Machine | None = None) -> list[RejectedEffect]:
    """Every alternative of a named effect, the one with the smallest error first."""
    stages = {(row.stage, row.target) for row in candidates if holds(row, effect.name, effect.target)}
    rows = [row for row in candidates if (row.stage, row.target) in stages]
    smallest = least_error(row for row in rows if holds(row, effect.name, effect.target))
    found = []
    for other in effect.alternatives:
        without = [row for row in rows if not holds(row, effect.name, effect.target)]
        times = least_error(row for row in without if holds(row, other.name, other.target)) / smallest
        title, target = effect_title(other.name, other.target, machine), owner_name(other.target)
        found.append(RejectedEffect(title, target, times, other.rejected_by))
    return sorted(found, key=lambda item: item.times if math.isfinite(item.times) else math.inf)


def outcome(row: ComparedModel, best: float, named: Sequence[tuple[str, str]]) -> tuple[str, bool]:
    """The result of a fitted set, and whether it was accepted; ``best`` is the smallest error at its stage."""
    if row.verdict.endswith("nats worse"):
        return f"predicts {row.verdict}", False
    effects = {label_of(text)[:2] for text in row.effects}
    times = row.selection_rmse / best if best > 0.0 else math.nan
    if effects and effects <= set(named) and times < 1.02:
        return "explains it", True
    if times >= CLEARLY_WORSE:
        return f"leaves {display.ratio(times)} the error of the best", False
    if times >= WORSE:
        return f"leaves {display.percent(times - 1.0)} more error than the best", False
    if math.isfinite(times):
        return "about as good, with more effects" if effects - set(named) else "about as good", False
    return "could not be fitted", False


def confidence(effect: NamedEffect, candidates: Sequence[ComparedModel], machine: Machine | None = None) -> list[str]:
    """Evidence for a name, and relative width of its intervals, as sentences."""
    sentences = []
    others = rejected(effect, candidates, machine)
    if others:
        nearest = others[0]
        text = f"{len(others)} alternative{'s were' if len(others) > 1 else ' was'} tested"
        if math.isfinite(nearest.times) and nearest.times >= WORSE:
            text += f"; the best, {nearest.title.lower()}, leaves {display.ratio(nearest.times)} the error on other recordings"
        sentences.append(text + ".")
    width = relative_width(effect)
    if math.isfinite(width):
        sentences.append(f"Its value{'s are' if len(effect.given) > 1 else ' is'} known to within ±{_percent(width)}.")
    return sentences


def relative_width(effect: NamedEffect) -> float:
    """Largest half width of a 95 % interval relative to its value; NaN for values near zero."""
    widths = []
    for name, value in effect.given.items():
        low, high = effect.interval95.get(name, (math.nan, math.nan))
        if isinstance(value, tuple) or isinstance(low, tuple) or isinstance(high, tuple) or value == 0.0:
            return math.nan
        widths.append(0.5 * (float(high) - float(low)) / abs(float(value)))
    widest = max(widths, default=math.nan)
    return widest if widest < 1.0 else math.nan


def _percent(share: float) -> str:
    return f"{display.number(100.0 * share, 2)}{display.NARROW_SPACE}%"
