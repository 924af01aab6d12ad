"""The page of a dataset version, from its manifest."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from sysid.datasets.versions.manifest import Manifest
from sysid.display import NOTHING, fixed, number, percent, quantity
from sysid.reports.clock_summary import clock_summary
from sysid.reports.pages import SiteBar, page
from sysid.site.dataset_items import ROLES
from sysid.site.item import Item

STYLES = ("page.css", "site.css")


def dataset_page(item: Item, manifest: Manifest, bar: SiteBar, lineage: Markup, report: str, command: str) -> str:
    """The page as HTML text.

    Args:
        report: relative URL of the report on its gap result; empty without one.
        command: that computes one.
    """
    flags = list(manifest["quality"].get("flags", []))
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
        recordings=list(_recordings(manifest, Counter(flag["recording"] for flag in flags))),
        signals=list(_signals(manifest)),
        clocks=[_clock(record) for record in manifest["clocks"]],
        clock_summary=clock_summary((c["recording"], c["applied"], 0.5 * _width(c)) for c in manifest["clocks"]),
        flags=flags,
        files=manifest["sources"],
        machine=list(manifest["machine"].items()),
    )


def _recordings(manifest: Manifest, flags: Mapping[str, int]) -> Iterator[dict[str, Any]]:
    for item in manifest["recordings"]:
        poses = item["kind"] == "poses"
        yield {
            "name": item["name"],
            "role": "static poses" if poses else ROLES.get(manifest["splits"].get(item["name"], ""), "no role"),
            "rows": item["rows"],
            "rate": NOTHING if poses else number(item["rate_hz"]),
            "seconds": NOTHING if poses else fixed(item["rows"] / item["rate_hz"], 1),
            "signals": len(item["signals"]),
            "flags": flags.get(item["name"], 0),
        }


def _signals(manifest: Manifest) -> Iterator[dict[str, Any]]:
    quality = manifest["quality"].get("recordings", {})
    poses = {item["name"] for item in manifest["recordings"] if item["kind"] == "poses"}
    for name, unit in manifest["units"].items():
        found = [entry["signals"][name] for entry in quality.values() if name in entry.get("signals", {})]
        moving = [
            entry["signals"][name] for key, entry in quality.items() if name in entry.get("signals", {}) and key not in poses
        ]
        if not found:
            continue
        yield {
            "name": name,
            "recordings": len(found),
            "low": quantity(min(map(_value, (entry.get("min") for entry in found))), unit),
            "high": quantity(max(map(_value, (entry.get("max") for entry in found))), unit),
            "missing": percent(sum(_value(entry.get("missing")) for entry in found) / len(found)),
            "gap": _longest([entry["longest_gap_s"] for entry in found if entry.get("longest_gap_s") is not None]),
            "noise": _noise([entry["noise"] for entry in moving if entry.get("noise") is not None], unit),
        }


def _noise(values: list[float], unit: str) -> str:
    return quantity(max(values), unit) if values else NOTHING


def _longest(values: list[float]) -> str:
    return fixed(max(values), 2) if values else NOTHING


def _value(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _clock(record: Mapping[str, Any]) -> dict[str, Any]:
    how = record["reason"][:1].upper() + record["reason"][1:]
    return {
        "recording": record["recording"],
        "stream": record["stream"],
        "offset": fixed(record["offset_s"], 6),
        "half": number(0.5e3 * _width(record)),
        "skew": fixed(record["skew_ppm"], 1),
        "how": how if record["applied"] else f"Not applied. {how}",
        "warning": not record["applied"],
    }


def _width(record: Mapping[str, Any]) -> float:
    """Width of the 95 % interval of a clock's offset [s]."""
    low, high = record["offset_interval95"]
    return float(high - low)
