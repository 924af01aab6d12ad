"""The map of disagreement: every stage driven by its measured input, against what sensor noise would give."""

from __future__ import annotations

import math
from typing import Any

from sysid.gap.result import Localised
from sysid.reports import display, words
from sysid.reports.inputs import ReportInputs


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
    guilty = sorted((item for item in found if item.share >= 0.005), key=lambda item: -item.share)
    return {
        "stages": [{"title": words.stage_name(stage), "about": words.STAGES.get(stage, ("", ""))[1]} for stage in stages],
        "rows": rows,
        "shares": [
            {"what": f"{words.signal_name(item.signal)}", "stage": words.stage_name(item.stage), "share": item.share}
            for item in guilty
        ],
    }


def _cell(items: list[Localised], inputs: ReportInputs, free: bool) -> dict[str, Any] | None:
    """The worst signal of a stage and axis; None where nothing is measured."""
    scored = [(item.free_run_rmse if free else item.stage_rmse, item) for item in items]
    scored = [(error, item) for error, item in scored if math.isfinite(error) and item.noise_floor > 0.0]
    if not scored:
        return None
    error, item = max(scored, key=lambda pair: pair[0] / pair[1].noise_floor)
    times = error / item.noise_floor
    unit = inputs.dataset.units.get(item.signal, "1")
    return {
        "ratio": display.ratio(times),
        "error": display.quantity(error, unit, 2),
        "floor": display.quantity(item.noise_floor, unit, 2),
        "signal": words.signal_name(item.signal),
        # 0 at 1.5 times the floor, full colour at a hundred times: a factor of ten is one step for the eye.
        "heat": round(100 * min(1.0, max(0.0, math.log10(max(times, 1e-9) / 1.5) / math.log10(100 / 1.5)))),
        "share": item.share if not free else 0.0,
    }
