"""What was found, as text beside the moving machine: effects with their values, errors before and after, the worst moments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from sysid.display import interval, quantity
from sysid.effects import BY_NAME
from sysid.effects.units import parameter_unit
from sysid.effects.wording import title_of
from sysid.gap.disagreement import worst_row
from sysid.gap.result import GapResult, NamedEffect
from sysid.machine import Machine
from sysid.view.drawing import TIMELINE, sdk

ENTITY, MOMENTS = "findings", "moments"


@dataclass(frozen=True)
class WorstMoment:
    """The row with the largest error of a simulated signal: ``error`` (simulated − measured) [SI] at ``time`` [s]."""

    signal: str
    version: str
    time: float
    error: float


def worst_moments(tables: Mapping[str, pd.DataFrame]) -> list[WorstMoment]:
    """Of every signal of every simulation; ``tables`` holds ``measured`` and simulations with the same rows."""
    found = []
    measured = tables["measured"]
    for version, table in tables.items():
        if version == "measured" or len(table) != len(measured):
            continue
        for signal in table.columns:
            if signal == "time" or signal.endswith(".command") or signal not in measured:
                continue
            worst = worst_row(table[signal], measured[signal])
            if worst is not None:
                found.append(WorstMoment(signal, version, float(measured["time"].iloc[worst[0]]), worst[1]))
    return found


def findings_text(gap: GapResult, machine: Machine, units: Mapping[str, str]) -> str:
    """The result as Markdown."""
    return "\n".join(_lines(gap, machine, units))


def log_findings(stream: Any, text: str, moments: list[WorstMoment], units: Mapping[str, str]) -> None:
    """The text, valid at all times, and a line at each worst moment."""
    rr = sdk()
    rr.log(ENTITY, rr.TextDocument(text, media_type="text/markdown"), static=True, recording=stream)
    for moment in sorted(moments, key=lambda item: item.time):
        rr.set_time(TIMELINE, duration=moment.time, recording=stream)
        size = quantity(abs(moment.error), units.get(moment.signal, "1"))
        level = "WARN" if moment.version == "before" else "INFO"
        text = f"{moment.version}: largest error of {moment.signal}, {size}"
        rr.log(MOMENTS, rr.TextLog(text, level=level), recording=stream)
    rr.reset_time(recording=stream)


def _lines(gap: GapResult, machine: Machine, units: Mapping[str, str]) -> Iterator[str]:
    yield f"## {gap.headline}\n"
    for effect in gap.effects:
        values = ", ".join(_value(effect, name, machine) for name in effect.parameters)
        title = title_of(BY_NAME[effect.name], effect.target, machine) if effect.name in BY_NAME else effect.name
        yield f"- **{title}** on {effect.target}: {values}"
    for item in gap.unnamed:
        yield f"- unnamed at the {item.stage} stage of {item.target}: depends on {item.depends_on}"
    yield "\n### Held-out error (RMSE)\n"
    yield "| signal | before | after | sensor noise |"
    yield "| --- | --- | --- | --- |"
    for signal, before in gap.gap.before.items():
        figures = (before, gap.gap.after.get(signal, before), gap.gap.noise_floor.get(signal, np.nan))
        texts = (quantity(value, units.get(signal, "1")) if np.isfinite(value) else "–" for value in figures)
        yield f"| {signal} | {' | '.join(texts)} |"


def _value(effect: NamedEffect, name: str, machine: Machine) -> str:
    unit = parameter_unit(effect.name, name, effect.target, machine, effect.units)
    value = effect.parameters[name]
    if not isinstance(value, int | float):
        return f"{name.replace('_', ' ')} {value}"
    low, high = effect.interval95.get(name, (np.nan, np.nan))
    spread = ""
    if not isinstance(low, tuple) and not isinstance(high, tuple) and np.isfinite([low, high]).all():
        spread = f" ({interval(low, high, unit, 4)})"
    return f"{name.replace('_', ' ')} {quantity(value, unit, 4)}{spread}"
