"""Recordings to make next, grouped over axes; console and report list the same ones."""

from __future__ import annotations

from sysid.datasets.recording import Dataset
from sysid.effects import effect_named
from sysid.gap.arm.sag import advice_on_sag, sagging_axis
from sysid.gap.excitation import TRAVEL_UNITS, axis_of
from sysid.gap.result import GapResult
from sysid.names import listed
from sysid.reports.words import effect_place, effect_title, tie_text


def next_steps(result: GapResult, dataset: Dataset) -> list[str]:
    """One text for each recording to make; effects that the same motion excites are grouped over their axes."""
    machine, steps = dataset.machine, list[str]()
    for planned in result.experiments:
        effects = [effect for purpose in planned.purposes for effect in purpose.effects]
        places = listed(list(dict.fromkeys(effect_place(effect.name, effect.target, machine) for effect in effects)))
        again = f", {planned.repeats} times" if planned.repeats > 1 else ""
        steps.append(f"Record {planned.name}.toml ({planned.about}, {planned.seconds:.0f} s{again}): {places}.")
    sagging = [axis for tie in result.ambiguous if (axis := sagging_axis(tie, machine))]
    steps += [advice_on_sag(sagging)] if sagging else []
    for tie in (tie for tie in result.ambiguous if not sagging_axis(tie, machine)):
        motions = dict.fromkeys(effect_named(name).need.advice.format(axis=target) for name, target in tie)
        steps.append(f"{' '.join(motions)} These recordings cannot distinguish {tie_text(tie, machine)}.")
    still: dict[str, None] = {}
    groups: dict[tuple[str, str], dict[str, None]] = {}
    for item in result.excitation:
        if item.sufficient:
            continue
        axis = axis_of(item.target, machine) or item.target
        if item.unit in TRAVEL_UNITS:
            still[axis] = None
        else:
            key = effect_named(item.name).need.advice, effect_title(item.name, axis, machine)
            groups.setdefault(key, {})[item.target] = None
    if still:
        axes = listed(list(still))
        steps.append(f"Record {axes} moving over {'its range' if len(still) == 1 else 'their ranges'}: not moved so far.")
    by_motion: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for (motion, title), targets in groups.items():
        by_motion.setdefault((motion, tuple(targets)), []).append(title)
    for (motion, where), titles in sorted(by_motion.items(), key=lambda item: -len(item[0][1]) * len(item[1])):
        of = listed([titles[0], *(each[0].lower() + each[1:] for each in titles[1:])])
        steps.append(f"{motion.format(axis=listed(list(where)))} {of}: not enough motion so far.")
    return steps
