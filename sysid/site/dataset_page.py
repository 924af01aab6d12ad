"""The page of a dataset version, from its manifest."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from sysid.datasets.versions.manifest import Manifest
from sysid.reports.display import NOTHING, fixed, number, percent, quantity
from sysid.reports.pages import SiteBar, page
from sysid.site.dataset_items import ROLES
from sysid.site.item import Item

#: An offset whose 95 % interval is wider than this is of no use at the usual rate of 100 Hz: half a sample [s].
COARSE_S = 0.005
STYLES = ("page.css", "site.css")


def dataset_page(item: Item, manifest: Manifest, bar: SiteBar, lineage: Markup, report: str, command: str) -> str:
    """The page as HTML text.

    Args:
        report: relative URL of the report on its gap result; empty without one.
        command: that computes one.
    """
    flags = list(manifest["quality"].get("flags", []))
    clocks = [_clock(record) for record in manifest["clocks"]]
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
        clocks=clocks,
        clock_verdict=_clock_verdict(clocks),
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
    low, high = record["offset_interval95"]
    half = (high - low) / 2.0
    how = record["reason"][:1].upper() + record["reason"][1:]
    return {
        "recording": record["recording"],
        "stream": record["stream"],
        "offset": fixed(record["offset_s"], 6),
        "half": number(1e3 * half),
        "skew": fixed(record["skew_ppm"], 1),
        "how": how if record["applied"] else f"Not applied. {how}",
        "warning": not record["applied"],
        "coarse": half > COARSE_S,
    }


def _clock_verdict(clocks: list[dict[str, Any]]) -> str:
    """How many clocks are aligned, and which are not."""
    fine = [clock for clock in clocks if not clock["warning"] and not clock["coarse"]]
    coarse = [clock["recording"] for clock in clocks if clock["coarse"] and not clock["warning"]]
    left = [clock["recording"] for clock in clocks if clock["warning"]]
    parts = [f"{len(fine)} of {len(clocks)} clocks are aligned to within {1e3 * COARSE_S:.0f} ms"]
    parts += [f"{', '.join(coarse)}: known less exactly"] if coarse else []
    parts += [f"{', '.join(left)}: not aligned"] if left else []
    return "; ".join(parts) + "."
