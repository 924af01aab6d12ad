"""Localisation: error of every stage, its share of the whole gap, and error maps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid import display
from sysid.gap.result import GapResult, Map, Share, StageGap
from sysid.names import listed
from sysid.reports import words
from sysid.reports.charts import ChartCurve, captioned, chart
from sysid.reports.inputs import ReportInputs
from sysid.signals import POINTS, point_signals

#: Number of maps of an output shown unfolded.
SHOWN = 3
#: A stage has an error from this multiple of its noise floor on.
MIN_RATIO = 1.5
#: Smallest explained share of a map that is described.
MIN_EXPLAINED = 0.15
#: Names of recordings in a sentence.
RECORDINGS = 8
#: Smallest listed share.
MIN_SHARE = 0.01


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    if inputs.gap is None or not inputs.gap.localised:
        return None
    found = inputs.gap.localised
    stages = [stage for stage in words.STAGES if any(item.stage == stage for item in found)]
    stages += sorted({item.stage for item in found} - set(stages))
    owners = [name for name in (*inputs.dataset.machine.axis_names, "ee", "tool") if any(item.target == name for item in found)]
    owners += sorted({item.target for item in found} - set(owners))
    rows = []
    for owner in owners:
        cells = [_cell([i for i in found if i.target == owner and i.stage == stage], inputs, free=False) for stage in stages]
        rows.append({"owner": owner, "cells": [*cells, _cell([i for i in found if i.target == owner], inputs, free=True)]})
    return {
        "stages": [{"title": words.stage_name(stage), "about": words.STAGES.get(stage, ("", ""))[1]} for stage in stages],
        "rows": rows,
        "ends": _ends(inputs.gap, inputs.dataset.units),
        "outputs": _outputs(inputs.gap, inputs),
        "repaired": any(item.after for item in inputs.gap.maps),
        "held_out": inputs.gap.held_out_recordings if inputs.gap.gap.before else (),
        "fitted": fit_recordings(inputs),
    }


def _cell(items: list[StageGap], inputs: ReportInputs, free: bool) -> dict[str, Any] | None:
    """Distance of a point, or the signal of a stage and axis with the largest error; None if nothing is measured."""
    assert inputs.gap is not None
    scored = [(*_error(item, inputs.gap, free), item.signal) for item in items]
    scored = [(error, floor, signal) for error, floor, signal in scored if math.isfinite(error) and floor > 0.0]
    if not scored:
        return None
    error, floor, signal = max(scored, key=lambda found: found[0] / found[1])
    unit, name = inputs.dataset.units.get(signal, "1"), words.signal_name(signal)
    if items[0].target in POINTS:
        error, floor = (math.hypot(*values) for values in ([e for e, _, _ in scored], [f for _, f, _ in scored]))
        name = f"{words.owner_name(items[0].target)} position"
    times = error / floor
    return {
        "ratio": display.ratio(times),
        "error": display.quantity(error, unit, 2),
        "floor": display.quantity(floor, unit, 2),
        "signal": name,
        # Logarithmic colour scale: 0 at 1.5 times the floor, 100 at a hundred times.
        "heat": round(100 * min(1.0, max(0.0, math.log10(max(times, 1e-9) / MIN_RATIO) / math.log10(100 / MIN_RATIO)))),
    }


def _error(item: StageGap, gap: GapResult, free: bool) -> tuple[float, float]:
    """Error and noise floor on held-out recordings; on those of the fits where a localisation held none out."""
    held_out = gap.gap if free else gap.stage_gap
    if item.signal in held_out.before:
        return held_out.before[item.signal], held_out.noise_floor[item.signal]
    return (item.free_run_rmse if free else item.stage_rmse), item.noise_floor


def fit_recordings(inputs: ReportInputs) -> str:
    """The recordings that localisation and fits use, in words: all that are not held out."""
    held_out = inputs.gap.held_out_recordings if inputs.gap is not None else ()
    names = [item.name for item in inputs.dataset.recordings]
    if not set(held_out) <= set(names):  # blocks of recordings
        return f"what is not held out of {listed(names, RECORDINGS)}"
    return listed([name for name in names if name not in held_out], RECORDINGS)


# -- shares --------------------------------------------------------------------------------------------------------------


def significant(shares: Sequence[Share], localised: Sequence[StageGap]) -> list[tuple[str, list[Share]]]:
    """End of the chain → its shares, the largest first; only ends with an error above the noise floor."""
    floors = {item.signal: item.noise_floor for item in localised}
    found = []
    for end in dict.fromkeys(share.end for share in shares):
        of_end = sorted((share for share in shares if share.end == end), key=lambda share: -share.share)
        signals = point_signals(end) if end in POINTS else (end,)
        floor = math.sqrt(sum(floors.get(signal, 0.0) ** 2 for signal in signals))
        if of_end[0].rmse > MIN_RATIO * floor:
            found.append((end, of_end))
    return found


def listed_shares(gap: GapResult, units: Mapping[str, str]) -> Iterator[tuple[str, str, list[Share], int]]:
    """End of the chain (the tool first), its SI unit, its shares from :data:`MIN_SHARE` on, and the number of smaller ones."""
    for end, shares in reversed(significant(gap.shares, gap.localised)):
        listed = [share for share in shares if abs(share.share) >= MIN_SHARE]
        yield end, units.get(f"{end}.x" if end in POINTS else end, "m"), listed, len(shares) - len(listed)


def _ends(gap: GapResult, units: Mapping[str, str]) -> list[dict[str, Any]]:
    return [
        {
            "what": f"{words.owner_name(end)} position" if end in POINTS else words.signal_name(end),
            "rows": [
                {
                    "where": words.stage_name(share.stage),
                    "owner": words.owner_name(share.target),
                    "share": display.percent(share.share),
                    "width": round(100 * min(1.0, max(0.0, share.share)), 1),
                    "moved": display.quantity(share.moved, unit, 2),
                }
                for share in shares
            ],
            "rest": rest,
        }
        for end, unit, shares, rest in listed_shares(gap, units)
    ]


# -- maps ----------------------------------------------------------------------------------------------------------------


def above_floor(gap: GapResult) -> list[StageGap]:
    """Outputs above their noise floor, the largest error first."""
    above = [i for i in gap.localised if i.noise_floor > 0.0 and i.stage_rmse > MIN_RATIO * i.noise_floor]
    return sorted(above, key=lambda item: -item.stage_rmse / item.noise_floor)


def maps_of(gap: GapResult, item: StageGap) -> list[Map]:
    """The maps of an output, those that explain most first."""
    return [found for found in gap.maps if (found.stage, found.target, found.signal) == (item.stage, item.target, item.signal)]


def _outputs(gap: GapResult, inputs: ReportInputs) -> list[dict[str, Any]]:
    outputs = []
    for item in above_floor(gap):
        maps = maps_of(gap, item)
        if not maps:
            continue
        command = f"{item.target}.command"
        drawn = [_characteristic(m) for m in maps if m.measured and m.over == command][:1] + [_figure(m) for m in maps]
        count = SHOWN if maps[0].explains > MIN_EXPLAINED else 1
        outputs.append(
            {
                "signal": words.signal_name(item.signal),
                "stage": words.stage_name(item.stage),
                "text": sentence(maps[0], item, inputs.dataset.units.get(item.signal, "1")),
                "first": drawn[:count],
                "others": drawn[count:],
            }
        )
    return outputs


def constant_share(item: Map, whole: StageGap) -> tuple[float, float]:
    """(mean error, its share of the mean square) of a map of the error."""
    weights = np.array(item.count, dtype=np.float64)
    mean = float(np.sum(weights * np.array(item.mean)) / weights.sum())
    return mean, min(1.0, (mean / whole.stage_rmse) ** 2) if whole.stage_rmse > 0.0 else 0.0


def sentence(most: Map, whole: StageGap, unit: str) -> str:
    """Description of the map that explains most of an output's error."""
    parts = []
    if most.quantity == "error":
        mean, share = constant_share(most, whole)
        if share > 0.5:
            parts.append(f"{display.percent(share)} of it is a constant {display.quantity(mean, unit, 2)}")
    if whole.frequency > 0.0:
        parts.append(f"{'the rest' if parts else 'it'} oscillates at {display.quantity(whole.frequency, 'Hz', 3)}")
    if most.explains > MIN_EXPLAINED:
        largest = int(np.argmax(np.abs(most.mean)))
        factor, label = display.shown_unit(most.unit)
        at = f"{display.number(factor * most.at[largest], 2)}{display.NARROW_SPACE}{label}".rstrip()
        at = DIRECTIONS.get(most.at[largest], at) if _is_direction(most) else f"at {at}"
        what = "the rest" if parts and whole.frequency == 0.0 else "the error"
        what = "the speed error" if most.quantity == "speed error" else what
        text = f"{what} depends most on {over_name(most.over)}, which explains {display.percent(most.explains)} of it"
        parts.append(f"{text} (largest {at}: {display.quantity(most.mean[largest], most.error_unit, 2)})")
    elif not parts:
        parts.append("it depends on no measured variable")
    text = "; ".join(parts)
    return text[0].upper() + text[1:] + "."


def over_name(over: str) -> str:
    """``boom.command`` → ``boom command``; ``load of boom`` is unchanged."""
    if "." in over and " " not in over:
        return words.signal_name(over)
    head, _, signal = over.partition(" of ")
    return f"{head} of {words.signal_name(signal)}" if "." in signal else over


#: Value of a direction → text.
DIRECTIONS = {-1.0: "backwards", 0.0: "at rest", 1.0: "forwards"}


def _is_direction(item: Map) -> bool:
    return item.over.startswith("direction of ")


def _figure(item: Map) -> Markup:
    labels = display.with_unit(over_name(item.over), item.unit), display.with_unit(item.quantity, item.error_unit)
    factor, x_factor = (display.shown_unit(unit)[0] for unit in (item.error_unit, item.unit))
    x = x_factor * np.array(item.at)
    lines = [ChartCurve(factor * np.array(item.mean), "before", dots=True, spread=factor * np.array(item.spread))]
    if item.after:
        lines.append(ChartCurve(factor * np.array(item.after), "after", dots=True))
    names = [DIRECTIONS.get(at, "") for at in item.at] if _is_direction(item) else []
    rows = display.fixed(float(sum(item.count)), 0)
    caption = f"over {over_name(item.over)}: explains {display.percent(item.explains)} ({rows} samples)"
    return captioned(chart(x, lines, labels, factor * item.noise_floor, names), caption)


def _characteristic(item: Map) -> Markup:
    """Speed over command, measured and simulated."""
    labels = display.with_unit(over_name(item.over), item.unit), display.with_unit("speed", item.error_unit)
    factor, x_factor = (display.shown_unit(unit)[0] for unit in (item.error_unit, item.unit))
    lines = [
        ChartCurve(factor * np.array(item.simulated), "before"),
        ChartCurve(factor * np.array(item.measured), "measured", dots=True),
    ]
    drawn = chart(x_factor * np.array(item.at), lines, labels)
    return captioned(drawn, "speed over command: measured (dots), simulated (line)")
