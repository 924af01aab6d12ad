"""The pages of a site, beside their templates: of a dataset version, from its manifest; of a run of a machine (how it ended,
its tracking error, and what the supervisor did); and about the whole workspace (overview, lineage, comparison).
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid.datasets.recording import Recording
from sysid.datasets.versions.manifest import Manifest, clock_from
from sysid.display import NOTHING, fixed, number, percent, quantity
from sysid.errors import StoreError
from sysid.figures import ParameterFigure, Table
from sysid.gap.result import GapResult
from sysid.machine import Machine
from sysid.registry import CHAMPION
from sysid.reports import words
from sysid.reports.charts import WIDE, ChartCurve, chart, embed
from sysid.reports.dataset_texts import clock_summary, clock_table, file_table, flag_lines, flag_table, kinds_of, role_text
from sysid.reports.pages import SiteBar, filled, page
from sysid.reports.picture import machine_picture, marks_of
from sysid.reports.result_figures import point_errors
from sysid.reports.sections.summary import main_errors
from sysid.reports.sections.traces import largest_error_signals, moment_chart, worst_moment
from sysid.site.inventory import ended
from sysid.site.item import WORDS, HeldOutError, Item
from sysid.site.lineage import around, drawing, lineage_graph
from sysid.site.sparklines import MOST_RECORDINGS, sparklines

FOLDER = Path(__file__).parent
STYLES = ("page.css", "site.css")


def dataset_page(
    item: Item,
    manifest: Manifest,
    recordings: Sequence[Recording],
    bar: SiteBar,
    lineage: Markup,
    report: str,
) -> str:
    """The page as HTML text.

    Args:
        recordings: of the version, for the curves.
        report: relative URL of the report on its gap result; empty without one.
    """
    flags, clocks = list(manifest["quality"].get("flags", [])), [clock_from(item) for item in manifest["clocks"]]
    lines = flag_lines(flags)
    return page(
        "dataset.html",
        STYLES,
        FOLDER,
        bar,
        title=item.reference,
        kind="Dataset version",
        facts=f"{item.summary} · machine {manifest['machine_name']} · made {item.created} UTC · content {item.digest[:12]}",
        drawing=lineage,
        report=report,
        command=f"sysid gap {item.reference} --add",
        recordings=_recordings(manifest, Counter(flag["recording"] for flag in flags)),
        curves=sparklines(recordings, manifest),
        more=max(0, len(recordings) - MOST_RECORDINGS),
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
        FOLDER,
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
    return chart(time, [ChartCurve(values, "after")], ("time [s]", "largest distance [mm]"), size=WIDE)


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


@dataclass(frozen=True)
class PlantTraces:
    """Keys of two plants, and a picture of a held-out recording with both, with its caption."""

    before: str
    after: str
    picture: Markup
    caption: str


def plant_traces(gap: GapResult, units: Mapping[str, str]) -> PlantTraces | None:
    """The signal with the largest error around its worst moment; None without traces."""
    for signal in largest_error_signals(gap):
        moment = worst_moment(gap.traces, signal, "before")
        if moment is None:
            continue
        trace = next(trace for trace in gap.traces if trace.recording == moment.recording)
        unit, label = units.get(signal, "1"), words.signal_name(signal)
        drawn = moment_chart(trace, moment, unit, label, repaired=True)
        text = f"{label}, held-out {moment.recording}: largest error {quantity(moment.before, unit, 2)}"
        return PlantTraces(f"plant:{gap.plant_before}", f"plant:{gap.plant_after}", drawn, text)
    return None


WORKSPACE_STYLES = ("page.css", "models.css", "site.css")
#: Most boxes of the drawing on the overview.
MOST = 40


def index_page(items: Sequence[Item], workspace: str, created: str, newest: Markup | None = None) -> str:
    """The overview: the newest gap result (:func:`result_summary`), what is in use, the lineage, and a table of everything with
    search, sorting and a choice of two."""
    whole = [item for item in items if item.kind not in ("damaged", "logs")]
    by_key = {item.key: item for item in items if item.kind != "damaged"}
    graph = lineage_graph(by_key.values())
    drawn = set(graph) if len(graph) <= MOST else set().union(*(around(graph, item.key) for item in in_use(items)[:5]))
    counts = Counter[str](item.kind for item in whole)
    return page(
        "index.html",
        WORKSPACE_STYLES,
        FOLDER,
        SiteBar(),
        title=workspace,
        kind="Workspace",
        facts=f"{len(whole)} items · {created}",
        in_use=in_use(items),
        drawing=drawing(graph.subgraph(drawn), by_key),
        more=len(drawn) < len(graph),
        newest=newest,
        count=len(graph),
        kinds=[(kind, WORDS[kind], counts[kind]) for kind in WORDS if counts[kind]],
        rows=[(item, _searched(item)) for item in whole],
        damaged=[f"{item.reference}: {item.damage}" for item in items if item.kind == "damaged"],
        **_script("site.js"),
    )


def result_summary(item: Item, gap: GapResult, machine: Machine, units: Mapping[str, str]) -> Markup:
    """Verdict, drawing and main errors of a gap result, with a link to its report."""
    return filled(
        "result.html",
        FOLDER,
        href=item.href,
        reference=item.reference,
        headline=gap.headline,
        picture=machine_picture(machine, marks_of(gap, machine)),
        effects=[words.effect_place(effect.name, effect.target, machine) for effect in gap.effects],
        errors=main_errors(point_errors(gap.gap, units)),
        repaired=gap.repaired,
        held_out=gap.held_out_recordings,
    )


def lineage_page(items: Sequence[Item], workspace: str) -> str:
    """All items and their sources."""
    by_key = {item.key: item for item in items if item.kind != "damaged"}
    drawn = drawing(lineage_graph(by_key.values()), by_key)
    return page(
        "lineage.html", WORKSPACE_STYLES, FOLDER, SiteBar(), title="Lineage", kind="Workspace", facts=workspace, drawing=drawn
    )


def compare_page(items: Sequence[Item], workspace: str, traces: Sequence[PlantTraces] = ()) -> str:
    """Two items side by side; the choice is made on the page, at first the newest two plants.

    Args:
        traces: pictures of two plants on one recording.
    """
    whole = [item for item in items if item.kind not in ("damaged", "logs")]
    groups = [(word, [item for item in whole if item.kind == kind]) for kind, word in WORDS.items()]
    data = {
        item.key: {
            "title": f"{item.word} {item.reference}",
            "href": item.href,
            "facts": [("Content", "content", item.digest[:12]), *((fact.group, fact.name, fact.text) for fact in item.facts)],
            "errors": [(e.where, e.name, e.value, e.noise_floor, quantity(e.value, e.unit)) for e in _own_errors(item)],
            "parameters": [(place, *_compared(figure)) for place, figure in item.parameters],
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
        first=first_pair(whole),
        traces=traces,
        data=embed("items", data),
        **_script("compare.js"),
    )


def _own_errors(item: Item) -> Iterator[HeldOutError]:
    return (error for error in item.errors if error.reference == item.reference and math.isfinite(error.value))


def _compared(figure: ParameterFigure) -> tuple[float | None, tuple[float, float] | None, str, str]:
    """Value and ends of its interval [SI] where they are numbers, and their texts."""
    value = float(figure.value) if isinstance(figure.value, float | int) else None
    ends = figure.interval95
    known = value is not None and ends is not None and all(isinstance(end, float | int) for end in ends)
    return value, (ends if known else None), figure.text, figure.interval


def first_pair(items: Sequence[Item]) -> tuple[str, str]:
    """Keys of the newest two plants, the older first; without two, of the newest two items of one kind, else of two items."""
    plants = [item for item in items if item.kind == "plant"]
    kinds = [plants, *([other for other in items if other.kind == item.kind] for item in items), list(items)]
    pair = next((own[:2] for own in kinds if len(own) > 1), list(items[:1]) * 2)
    pair.sort(key=lambda item: item.created)
    return (pair[0].key, pair[1].key) if pair else ("", "")


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


def _searched(item: Item) -> str:
    """What the search of the page looks through."""
    facts = (text for fact in item.facts for text in (fact.name, fact.text))
    own = (item.reference, item.word, item.kind, item.summary, item.digest, item.created, *item.aliases)
    return " ".join((*own, *facts)).lower()


def _script(name: str) -> dict[str, Any]:
    """A script, and its hash for the page's content security policy, which permits no other."""
    text = (FOLDER / name).read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
    return {"script": Markup(text), "script_hash": f"sha256-{digest}"}
