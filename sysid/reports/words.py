"""Stages, verdicts, signals and named effects as reports and the console write them."""

from __future__ import annotations

import string
from collections.abc import Collection, Mapping

from sysid.effects import BY_NAME

#: Stage → what is compared, in the order of the signal chain.
STAGES: dict[str, tuple[str, str]] = {
    "command": ("Command → actuator", "driven by the recorded command"),
    "force": ("Force → motion", "force that the measured motion needs"),
    "joint": ("Actuator → joint", "driven by the measured actuator"),
    "end_effector": ("Joints → tip", "driven by the measured joints"),
    "tool": ("Tip → tool", "driven by the measured tip"),
}

OWNERS = {"ee": "boom tip", "tool": "tool", "machine": "whole machine", "base": "base"}

HEADLINES = {
    "no_gap": "The simulation agrees with the machine to within sensor noise.",
    "unnamed": "Something is missing from the simulation that none of the known effects explains.",
    "ambiguous": "The cause is narrowed down, but these recordings cannot tell the remaining candidates apart.",
    "insufficient_excitation": "Simulation and machine disagree, but these recordings lack what is needed to say why.",
}

ADVICE = {
    "no_gap": "Nothing was added. Another motion may still show one: see below what these recordings could not show.",
    "unnamed": "No name was given, because a wrong one is worse than none. What is known about the remainder is listed below.",
    "ambiguous": "Nothing was guessed. The recording that would break the tie is described under “What to record next”.",
    "insufficient_excitation": "The recordings that would settle it are described under “What to record next”.",
}

_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")


def effect_title(name: str) -> str:
    return BY_NAME[name].title if name in BY_NAME else name.replace("_", " ").capitalize()


def effect_sentence(name: str, target: str, parameters: Mapping[str, str], beside: Collection[str] = ()) -> str:
    """One sentence about a named effect.

    Args:
        parameters: already formatted with their units.
        beside: what else was named on the same target.
    """
    values = {"target": owner_name(target), **parameters}
    effect = BY_NAME.get(name)
    templates = [*(text for other, text in effect.beside.items() if other in beside), *effect.sentences] if effect else []
    for template in templates:
        if {field for _, field, _, _ in string.Formatter().parse(template) if field} <= set(values):
            return template.format(**values)
    listed = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in parameters.items())
    return f"{effect_title(name)} of the {values['target']}: {listed}."


def owner_name(target: str) -> str:
    return OWNERS.get(target, target)


def signal_name(signal: str) -> str:
    """``boom.cylinder`` → ``boom cylinder``; ``ee.x`` → ``boom tip x``."""
    owner, _, quantity = signal.rpartition(".")
    return f"{owner_name(owner)} {quantity}"


def stage_name(stage: str) -> str:
    return STAGES[stage][0] if stage in STAGES else stage.replace("_", " ").capitalize()


def localised(places: list[str]) -> str:
    """Where the stages disagree, as a sentence."""
    if not places:
        return "At every stage the simulation agrees with the machine to within sensor noise."
    listed = ", ".join(places[:4]) + (f" and {len(places) - 4} more" if len(places) > 4 else "")
    return f"Simulation and machine disagree at: {listed}."


def headline(verdict: str, effects: int) -> str:
    """The verdict as a sentence."""
    if verdict != "named":
        return HEADLINES.get(verdict, verdict)
    count = _COUNTS[effects] if effects < len(_COUNTS) else str(effects)
    return f"{count} effect{' is' if effects == 1 else 's are'} missing from the simulation."
