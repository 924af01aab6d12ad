"""HTML pages about model versions: the card of one, and an overview of a workspace; without external content."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from sysid import display
from sysid.registry import CANDIDATE, CHAMPION, ModelVersion, ancestors
from sysid.registry.decision import decision_row
from sysid.registry.figures import held_out_figures
from sysid.reports.charts import WIDE, ChartCurve, chart, heat_map
from sysid.reports.pages import SiteBar, page
from sysid.reports.words import signal_name
from sysid.validate import ErrorMap
from sysid.versions import Card

STYLES = ("page.css", "models.css")
#: Style classes of the lines of a chart.
LINE_CLASSES = ("c1", "c2", "c3", "c4", "after", "before", "measured")


def card_page(card: Card, bar: SiteBar | None = None, lineage: Markup | None = None) -> str:
    """The card as a whole HTML page.

    Args:
        bar: links to the other pages of a site that it is part of.
        lineage: a drawing of what the version was made from, and what was made from it.
    """
    blocks = [
        {
            "name": f"part-{number}",
            "title": block.title,
            "text": [_inline(text) for text in block.text],
            "header": block.header,
            "rows": block.rows,
            "code": block.code,
            "maps": [Markup(_map(*item)) for item in block.maps],
        }
        for number, block in enumerate(card.blocks)
    ]
    values: dict[str, Any] = {"title": card.title, "kind": "Model card", "facts": card.facts, "blocks": blocks}
    return page("model_card.html", STYLES, bar=bar, lineage=lineage, **values)


def models_page(
    versions: Sequence[ModelVersion],
    workspace: str,
    created: str = "",
    cards: Mapping[str, str] | None = None,
    bar: SiteBar | None = None,
) -> str:
    """All versions of a workspace: aliases, figures, lineage and decisions.

    Args:
        versions: from ``Registry.list``.
        created: time as text; empty to leave it out.
        cards: reference → relative URL of its card.
        bar: as for :func:`card_page`.
    """
    models = []
    for name in sorted({version.name for version in versions}):
        own = sorted((version for version in versions if version.name == name), key=lambda version: -version.version)
        models.append(
            {
                "name": name,
                "kind": own[0].kind,
                "champion": next((version.reference for version in own if CHAMPION in version.aliases), ""),
                "newest": own[0].reference,
                "charts": [Markup(text) for text in _charts(own[::-1])],
                "versions": [_entry(version, versions, (cards or {}).get(version.reference, "")) for version in own],
            }
        )
    values: dict[str, Any] = {
        "title": "Models",
        "kind": "Model versions",
        "facts": workspace,
        "created": created,
        "models": models,
    }
    return page("models_page.html", STYLES, bar=bar, **values)


def _entry(version: ModelVersion, versions: Sequence[ModelVersion], card: str) -> dict[str, Any]:
    children = [other.reference for other in versions if version.reference in {p.reference for p in ancestors(versions, other)}]
    dataset = str(version.lineage.get("dataset", ""))
    return {
        "reference": version.reference,
        "aliases": [alias for alias in version.aliases if alias in (CHAMPION, CANDIDATE)]
        + [alias for alias in version.aliases if alias not in (CHAMPION, CANDIDATE)],
        "created": f"{datetime.fromtimestamp(version.created_ms / 1e3, UTC):%Y-%m-%d %H:%M}",
        "digest": version.digest[:12],
        "card": card,
        "dataset": dataset,
        "parents": [parent.reference for parent in ancestors(versions, version)],
        "children": children,
        "figures": _figures(version),
        "decisions": [
            {
                "when": when,
                "what": what,
                "by": by,
                "why": why,
                "promoted": decision.promoted,
                "checks": decision.checks,
            }
            for decision in version.decisions[::-1]
            for when, what, by, why in (decision_row(decision),)
        ],
    }


def _figures(version: ModelVersion) -> list[dict[str, str]]:
    return [{**asdict(row), "output": signal_name(row.signal)} for row in held_out_figures(version)]


def _charts(versions: Sequence[ModelVersion]) -> list[str]:
    """RMSE over the versions, one chart per unit and kind of rows; none for a single version."""
    keys = dict.fromkeys(key for version in versions for key in version.metrics if key.endswith(".rmse"))
    if len(versions) < 2:
        return []
    groups: dict[tuple[str, bool], list[str]] = {}
    for key in keys:
        signal, _, kind = key.removesuffix(".rmse").rpartition(".")
        groups.setdefault((_unit(signal), kind == "poses"), []).append(key)
    found = []
    numbers, names = np.arange(len(versions), dtype=np.float64), [f"@{version.version}" for version in versions]
    for (unit, _), own in groups.items():
        factor, label = display.shown_unit(unit)
        lines = [
            ChartCurve(np.array([factor * version.metrics.get(key, np.nan) for version in versions]), look, dots=True)
            for key, look in zip(own, LINE_CLASSES, strict=False)
        ]
        legend = "".join(
            f'<span class="line {look}"></span>{escape(_title(key))}' for key, look in zip(own, LINE_CLASSES, strict=False)
        )
        drawn = chart(numbers, lines, ("version", f"RMSE [{label}]"), names=names, size=WIDE)
        found.append(f"<figure>{drawn}<figcaption>{legend}</figcaption></figure>")
    return found


def _map(output: str, unit: str, item: ErrorMap) -> str:
    """RMSE of an output in bins of two variables."""
    factor, label = display.shown_unit(unit)
    scales = [display.shown_unit(own) if own in ("m", "rad", "m/s", "rad/s") else (1.0, own) for own in item.units]
    edges = [scale * np.array(part) for (scale, _), part in zip(scales, item.edges, strict=True)]
    labels = [f"{signal_name(name)} [{shown_as}]" for name, (_, shown_as) in zip(item.over, scales, strict=True)]
    drawn = heat_map(factor * np.array(item.rmse), np.array(item.count), (edges[0], edges[1]), (labels[0], labels[1]), label)
    return f"<figure>{drawn}<figcaption>{escape(output)}</figcaption></figure>"


def _title(key: str) -> str:
    signal, _, kind = key.removesuffix(".rmse").rpartition(".")
    return f"{signal_name(signal)}, {'poses' if kind == 'poses' else 'motion'}"


def _unit(signal: str) -> str:
    return "rad" if signal.endswith(".joint") else "m"


def _inline(text: str) -> Markup:
    """``code`` between backticks; everything else escaped."""
    parts = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if number % 2 else escape(part) for number, part in enumerate(parts)
    )
