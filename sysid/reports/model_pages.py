"""HTML pages about model versions: the card of one, and an overview of a workspace; without external content."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from sysid import display
from sysid.figures import Table, stored_errors, stored_parameters
from sysid.registry import CANDIDATE, CHAMPION, ModelVersion, ancestors
from sysid.registry.promotion import decision_row
from sysid.reports.card import Card, plant_errors
from sysid.reports.charts import WIDE, ChartCurve, captioned, chart, heat_map
from sysid.reports.pages import SiteBar, page
from sysid.reports.words import effect_title, signal_name
from sysid.validate import ErrorMap

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
            "table": block.table,
            "code": block.code,
            "maps": [_map(*item) for item in block.maps],
        }
        for number, block in enumerate(card.blocks)
    ]
    values: dict[str, Any] = {"title": card.title, "kind": "Model card", "facts": card.facts, "blocks": blocks}
    return page("model_card.html", STYLES, bar=bar, lineage=lineage, **values)


def models_page(
    versions: Sequence[ModelVersion],
    workspace: str,
    cards: Mapping[str, str] | None = None,
    bar: SiteBar | None = None,
) -> str:
    """All versions of a workspace: aliases, figures, lineage and decisions.

    Args:
        versions: from ``Registry.list``.
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
                "charts": _charts(own[::-1]),
                "versions": [_entry(version, versions, (cards or {}).get(version.reference, "")) for version in own],
            }
        )
    values: dict[str, Any] = {
        "title": "Models",
        "kind": "Model versions",
        "facts": workspace,
        "models": models,
    }
    return page("models_page.html", STYLES, bar=bar, **values)


def _entry(version: ModelVersion, versions: Sequence[ModelVersion], card: str) -> dict[str, Any]:
    named = [alias for alias in (CHAMPION, CANDIDATE) if alias in version.aliases]
    return {
        "version": version,
        "aliases": [*named, *(alias for alias in version.aliases if alias not in named)],
        "created": display.minute(version.created_ms),
        "card": card,
        "parents": [parent.reference for parent in ancestors(versions, version)],
        "children": [other.reference for other in versions if version in ancestors(versions, other)],
        "figures": _figures(version),
        "decisions": [(decision, decision_row(decision)) for decision in version.decisions[::-1]],
    }


def _figures(version: ModelVersion) -> Table:
    rows = [
        (signal_name(error.output), Markup('<span class="quiet">{}</span>').format(error.rows), *error.texts)
        for error in stored_errors(version.metrics)
    ]
    return Table(("Held out", "", "RMSE", "95 %", "max"), rows, (2, 3, 4))


def _charts(versions: Sequence[ModelVersion]) -> list[Markup]:
    """RMSE and parameters of effects over the versions, one chart per unit and kind; none for a single version."""
    if len(versions) < 2:
        return []
    curves: dict[tuple[str, str, str], dict[str, list[float]]] = {}

    def put(group: tuple[str, str, str], name: str, at: int, value: float) -> None:
        curves.setdefault(group, {}).setdefault(name, [math.nan] * len(versions))[at] = value

    for at, version in enumerate(versions):
        for error in stored_errors(version.metrics):
            put(("RMSE", error.unit, error.rows), f"{signal_name(error.output)}, {error.rows}", at, error.rmse)
        for figure in plant_errors(version.lineage, {}):
            put(("held-out error", figure.unit, ""), figure.name, at, figure.after)
            for before, other in enumerate(versions):
                if other.reference == version.lineage.get("plant") and not plant_errors(other.lineage, {}):
                    put(("held-out error", figure.unit, ""), figure.name, before, figure.before)
        for effect in version.lineage.get("effects", ()):
            title = f"{effect_title(effect['name'])}, {effect['target']}"
            for parameter in stored_parameters(effect):
                if isinstance(parameter.value, float | int):
                    put((title, parameter.unit, parameter.name), parameter.label, at, float(parameter.value))
    return [
        _chart(versions, group, own) for group, own in curves.items() if any(np.isfinite(v).sum() > 1 for v in own.values())
    ]


def _chart(versions: Sequence[ModelVersion], group: tuple[str, str, str], curves: Mapping[str, Sequence[float]]) -> Markup:
    """Curves of one quantity over the versions, with a legend."""
    what, unit, _ = group
    factor, _ = display.shown_unit(unit)
    styled = list(zip(curves.items(), LINE_CLASSES, strict=False))
    lines = [ChartCurve(factor * np.array(values), look, dots=True) for (_, values), look in styled]
    legend = Markup("").join(Markup('<span class="line {}"></span>{}').format(look, name) for (name, _), look in styled)
    numbers, names = np.arange(len(versions), dtype=np.float64), [f"@{version.version}" for version in versions]
    drawn = chart(numbers, lines, ("version", display.with_unit(what, unit)), names=names, size=WIDE)
    return captioned(drawn, legend)


def _map(output: str, unit: str, item: ErrorMap) -> Markup:
    """RMSE of an output in bins of two variables."""
    factor, label = display.shown_unit(unit)
    a, b = (display.shown_unit(own)[0] * np.array(part) for own, part in zip(item.units, item.edges, strict=True))
    across, up = (display.with_unit(signal_name(name), own) for name, own in zip(item.over, item.units, strict=True))
    drawn = heat_map(factor * np.array(item.rmse), np.array(item.count), (a, b), (across, up), label)
    return captioned(drawn, output)


def _inline(text: str) -> Markup:
    """``code`` between backticks; everything else escaped."""
    parts = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if number % 2 else escape(part) for number, part in enumerate(parts)
    )
