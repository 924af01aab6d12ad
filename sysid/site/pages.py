"""The pages of a site, beside their templates: of a dataset version, from its manifest; of a run of a machine (how it ended,
its tracking error, and what the supervisor did); and about the whole workspace (overview, lineage, comparison).
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid.datasets.versions.manifest import Manifest, clock_from
from sysid.display import NOTHING, fixed, number, percent, quantity
from sysid.errors import StoreError
from sysid.figures import Table
from sysid.registry import CHAMPION
from sysid.reports.charts import WIDE, ChartCurve, chart, embed
from sysid.reports.dataset_texts import clock_summary, clock_table, file_table, flag_lines, flag_table, kinds_of, role_text
from sysid.reports.pages import SiteBar, page
from sysid.site.inventory import ended
from sysid.site.item import WORDS, Item
from sysid.site.lineage import around, drawing, lineage_graph

STYLES = ("page.css", "site.css")


def dataset_page(item: Item, manifest: Manifest, bar: SiteBar, lineage: Markup, report: str, command: str) -> str:
    """The page as HTML text.

    Args:
        report: relative URL of the report on its gap result; empty without one.
        command: that computes one.
    """
    flags, clocks = list(manifest["quality"].get("flags", [])), [clock_from(item) for item in manifest["clocks"]]
    lines = flag_lines(flags)
    return page(
        "dataset.html",
        STYLES,
        Path(__file__).parent,
        bar,
        title=item.reference,
        kind="Dataset version",
        facts=f"{item.summary} · machine {manifest['machine_name']} · made {item.created} UTC · content {item.digest[:12]}",
        drawing=lineage,
        report=report,
        command=command,
        recordings=_recordings(manifest, Counter(flag["recording"] for flag in flags)),
        signals=_signals(manifest),
        clocks=clock_table(clocks),
        clock_summary=clock_summary(clocks),
        flags=flag_table(lines),
        flag_kinds=kinds_of(lines),
        files=file_table((s["path"], s["size"], s["sha256"], s["losses"]) for s in manifest["sources"]),
        machine=list(manifest["machine"].items()),
    )


def _recordings(manifest: Manifest, flags: Mapping[str, int]) -> Table:
    rows = []
    for item in manifest["recordings"]:
        poses = item["kind"] == "poses"
        rate, seconds = (NOTHING, NOTHING) if poses else (number(item["rate_hz"]), fixed(item["rows"] / item["rate_hz"], 1))
        role = role_text(item["kind"], manifest["splits"].get(item["name"]))
        rows.append((item["name"], role, item["rows"], rate, seconds, len(item["signals"]), flags.get(item["name"], 0)))
    header = ("recording", "role", "rows", "rate [Hz]", "time [s]", "signals", "flagged sections")
    return Table(header, rows, range(2, 7))


def _signals(manifest: Manifest) -> Table:
    quality = manifest["quality"].get("recordings", {})
    poses = {item["name"] for item in manifest["recordings"] if item["kind"] == "poses"}
    rows = []
    for name, unit in manifest["units"].items():
        found = {key: entry["signals"][name] for key, entry in quality.items() if name in entry.get("signals", {})}
        if not found:
            continue
        low, high = (_known(found.values(), key) for key in ("min", "max"))
        gaps = [entry["longest_gap_s"] for entry in found.values() if entry.get("longest_gap_s") is not None]
        noise = [entry["noise"] for key, entry in found.items() if key not in poses and entry.get("noise") is not None]
        rows.append(
            (
                name,
                len(found),
                quantity(min(low), unit),
                quantity(max(high), unit),
                percent(sum(_known(found.values(), "missing")) / len(found)),
                fixed(max(gaps), 2) if gaps else NOTHING,
                quantity(max(noise), unit) if noise else NOTHING,
            )
        )
    return Table(("signal", "recordings", "from", "to", "missing", "longest gap [s]", "noise"), rows, range(1, 7))


def _known(entries: Iterable[Mapping[str, Any]], key: str) -> list[float]:
    """A figure of every recording; NaN where it is null."""
    return [math.nan if entry.get(key) is None else float(entry[key]) for entry in entries]


def _code(text: str) -> Markup:
    return Markup("<code>{}</code>").format(text)


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
        timing=_timing(values),
        error_of=values.get("error_of") or "",
        error=_error_rows(values),
        curve=_curve(values.get("distance_by_second_mm") or []),
        violations=list((values.get("verdicts") or {}).items()),
        events=_events(values["events"]),
        events_lost=values.get("events_lost", 0),
        versions=Table(("version", "content"), [(name, _code(digest[:12])) for name, digest in values["versions"].items()]),
        log=str(log),
        logs=str(log.parent.parent),
        sha256=values["sha256"],
    )


def _timing(values: Mapping[str, Any]) -> Table:
    rows = []
    for title, key in TIMES:
        if key in values:
            found = (values[key][quantile] for quantile in QUANTILES)
            rows.append((title, *(NOTHING if value is None else fixed(value, 0) for value in found)))
    return Table(("[µs]", "p50", "p99", "largest"), rows, (1, 2, 3))


def _error_rows(values: Mapping[str, Any]) -> Table:
    """Distance and coordinates: mean, RMSE and largest error [mm]."""
    rows: list[tuple[str, ...]] = []
    if distance := values.get("distance_mm"):
        rows.append(("distance", *(fixed(distance[key], 2) for key in ("mean", "rmse", "max"))))
        axes = zip("xyz", values["rmse_mm"], values["max_mm"], strict=True)
        rows += [(axis, "", fixed(rmse, 2), fixed(worst, 2)) for axis, rmse, worst in axes]
    return Table(("", "mean [mm]", "RMSE [mm]", "largest [mm]"), rows, (1, 2, 3))


def _curve(rows: list[tuple[int, float]]) -> Markup:
    """The largest distance in each second; seconds without motion are a gap."""
    if len(rows) < 2:
        return Markup("")
    seconds, far = np.array(rows, dtype=np.float64).T
    time = np.arange(seconds[0], seconds[-1] + 1.0)
    values = np.full(len(time), np.nan)
    values[(seconds - seconds[0]).astype(np.int64)] = far
    return Markup(chart(time, [ChartCurve(values, "after")], ("time [s]", "largest distance [mm]"), size=WIDE))


def _events(events: Sequence[Mapping[str, Any]]) -> Table:
    rows: list[tuple[object, ...]] = []
    row_classes = {}
    for event in events:
        time, violation = fixed(event["time_s"], 2), event["kind"] == "violation"
        if event["reaction"] in SEVERE if violation else event["text"] == "fault":
            row_classes[len(rows)] = "refused"
        what = f"{event['check']} of {event['target']}" if violation else "state"
        reaction, cycles = (event["reaction"], event["cycles"]) if violation else ("", "")
        rows.append((time, what, event["text"], reaction, cycles))
    return Table(("time [s]", "what", "", "reaction", "cycles"), rows, (0, 4), row_classes=row_classes)


FOLDER = Path(__file__).parent
WORKSPACE_STYLES = ("page.css", "models.css", "site.css")
#: Most boxes of the drawing on the overview.
MOST = 40


def index_page(items: Sequence[Item], workspace: str, created: str) -> str:
    """The overview: what is in use, the lineage, and a table of everything with search, sorting and a choice of two."""
    whole = [item for item in items if item.kind not in ("damaged", "logs")]
    by_key = {item.key: item for item in items if item.kind != "damaged"}
    graph = lineage_graph(by_key.values())
    newest = set(graph) if len(graph) <= MOST else set().union(*(around(graph, item.key) for item in in_use(items)[:5]))
    counts = Counter[str](item.kind for item in whole)
    return page(
        "index.html",
        WORKSPACE_STYLES,
        FOLDER,
        SiteBar(),
        title=workspace,
        kind="Workspace",
        facts=f"{len(whole)} items · {created}",
        in_use=[_use(item) for item in in_use(items)],
        drawing=drawing(graph.subgraph(newest), by_key),
        more=len(newest) < len(graph),
        count=len(graph),
        kinds=[(kind, WORDS[kind], counts[kind]) for kind in WORDS if counts[kind]],
        rows=[_row(item) for item in whole],
        damaged=[f"{item.reference}: {item.damage}" for item in items if item.kind == "damaged"],
        **_script("site.js"),
    )


def lineage_page(items: Sequence[Item], workspace: str) -> str:
    """All items and their sources."""
    by_key = {item.key: item for item in items if item.kind != "damaged"}
    drawn = drawing(lineage_graph(by_key.values()), by_key)
    return page(
        "lineage.html", WORKSPACE_STYLES, FOLDER, SiteBar(), title="Lineage", kind="Workspace", facts=workspace, drawing=drawn
    )


def compare_page(items: Sequence[Item], workspace: str) -> str:
    """Two items side by side; the choice is made on the page."""
    whole = [item for item in items if item.kind not in ("damaged", "logs")]
    groups = [(word, [item for item in whole if item.kind == kind]) for kind, word in WORDS.items()]
    data = {
        item.key: {
            "title": f"{item.word} {item.reference}",
            "href": item.href,
            "facts": [("Content", "content", item.digest[:12]), *((fact.group, fact.name, fact.text) for fact in item.facts)],
        }
        for item in whole
    }
    return page(
        "compare.html",
        WORKSPACE_STYLES,
        FOLDER,
        SiteBar(),
        title="Compare",
        kind="Workspace",
        facts=workspace,
        groups=[(word, own) for word, own in groups if own],
        data=embed("items", data),
        **_script("compare.js"),
    )


def in_use(items: Sequence[Item]) -> list[Item]:
    """Of each model name the champion, else the newest version: what the name alone means."""
    found: dict[tuple[str, str], list[Item]] = {}
    for item in items:
        if item.kind not in ("damaged", "logs", "dataset", "gap", "flight"):
            found.setdefault((item.kind, item.name), []).append(item)
    return [
        next((item for item in own if CHAMPION in item.aliases), max(own, key=lambda item: int(item.reference.split("@")[-1])))
        for own in found.values()
    ]


def _use(item: Item) -> dict[str, Any]:
    own = {"href": item.href, "reference": f"{item.name} → {item.reference}", "word": item.word, "summary": item.summary}
    return {**own, "promoted": CHAMPION in item.aliases}


def _row(item: Item) -> dict[str, Any]:
    return {
        "kind": item.kind,
        "key": item.key,
        "word": item.word,
        "reference": item.reference,
        "sort": item.reference,
        "href": item.href,
        "aliases": item.aliases,
        "summary": item.summary,
        "created": item.created,
        "digest": item.digest[:12],
        "text": " ".join(_searched(item)).lower(),
    }


def _searched(item: Item) -> Iterator[str]:
    yield from (item.reference, item.word, item.kind, item.summary, item.digest, item.created, *item.aliases)
    for fact in item.facts:
        yield from (fact.name, fact.text)


def _script(name: str) -> dict[str, Any]:
    """A script, and its hash for the page's content security policy, which permits no other."""
    text = (FOLDER / name).read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
    return {"script": Markup(text), "script_hash": f"sha256-{digest}"}
