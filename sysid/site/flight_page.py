"""The page of a run of a machine: how it ended, its tracking error, and what the supervisor did."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid.display import NOTHING, fixed
from sysid.errors import StoreError
from sysid.reports.charts import WIDE, ChartCurve, chart
from sysid.reports.pages import SiteBar, page
from sysid.site.flight_items import ended
from sysid.site.item import Item

STYLES = ("page.css", "site.css")
#: Columns and rows of the table of times.
QUANTILES = ("p50", "p99", "max")
TIMES = (("lateness of a cycle", "lateness_us"), ("time of a cycle", "turn_us"))
#: Reactions to which the machine stops or stands still.
SEVERE = ("hold", "stop", "fault")


def flight_page(item: Item, values: Mapping[str, Any], bar: SiteBar, lineage: Markup) -> str:
    """The page as HTML text.

    Args:
        values: the record of the run.

    Raises:
        StoreError: the record was changed.
    """
    try:
        return _page(item, values, bar, lineage)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        found = f"damaged: {type(error).__name__}: {error}"
        raise StoreError(f"record of the run {item.reference}", found, "what `sysid run` writes") from error


def _page(item: Item, values: Mapping[str, Any], bar: SiteBar, lineage: Markup) -> str:
    log = Path(values["log"])
    return page(
        "flight.html",
        STYLES,
        Path(__file__).parent,
        bar,
        title=item.reference,
        kind="Run of a machine",
        facts=f"{values['name']} · {values['mode']} on {values['machine']}, {values['transport']} · began {item.created} UTC",
        drawing=lineage,
        ended=ended(values),
        bad=values["ended"] in (None, "fault"),
        notes=values.get("notes", []),
        figures=[(fact.name, fact.text) for fact in item.facts if fact.group == "Result" and fact.name != "ended"],
        timing=[(title, _microseconds(values[key])) for title, key in TIMES if key in values],
        error_of=values.get("error_of") or "",
        error=_error_rows(values),
        curve=_curve(values.get("distance_by_second_mm") or []),
        violations=list((values.get("verdicts") or {}).items()),
        events=[_event(event) for event in values["events"]],
        events_lost=values.get("events_lost", 0),
        versions=[(name, digest[:12]) for name, digest in values["versions"].items()],
        log=str(log),
        logs=str(log.parent.parent),
        sha256=values["sha256"],
    )


def _microseconds(times: Mapping[str, float | None]) -> list[str]:
    found = [times[quantile] for quantile in QUANTILES]
    return [NOTHING if value is None else fixed(value, 0) for value in found]


def _error_rows(values: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Distance and coordinates: mean, RMSE and largest error [mm]."""
    distance = values.get("distance_mm")
    if not distance:
        return []
    axes = zip("xyz", values["rmse_mm"], values["max_mm"], strict=True)
    first = ("distance", *(fixed(distance[key], 2) for key in ("mean", "rmse", "max")))
    return [first, *((axis, "", fixed(rmse, 2), fixed(worst, 2)) for axis, rmse, worst in axes)]


def _curve(rows: list[tuple[int, float]]) -> Markup:
    """The largest distance in each second; seconds without motion are a gap."""
    if len(rows) < 2:
        return Markup("")
    seconds, far = np.array(rows, dtype=np.float64).T
    time = np.arange(seconds[0], seconds[-1] + 1.0)
    values = np.full(len(time), np.nan)
    values[(seconds - seconds[0]).astype(np.int64)] = far
    return Markup(chart(time, [ChartCurve(values, "after")], ("time [s]", "largest distance [mm]"), size=WIDE))


def _event(event: Mapping[str, Any]) -> dict[str, Any]:
    violation = event["kind"] == "violation"
    return {
        "time": fixed(event["time_s"], 2),
        "what": f"{event['check']} of {event['target']}" if violation else "state",
        "text": event["text"],
        "reaction": event["reaction"] if violation else "",
        "cycles": event["cycles"] if violation else "",
        "severe": event["reaction"] in SEVERE if violation else event["text"] == "fault",
    }
