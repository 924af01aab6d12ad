"""Blocks of an error report on a card: figures, simple models, error maps, coverage of intervals."""

from __future__ import annotations

from collections.abc import Iterator

from sysid.display import interval, percent, quantity
from sysid.networks.uncertainty import FALSE_FLAGS
from sysid.validate import OutputReport, ValidationReport
from sysid.versions.card_block import CardBlock
from sysid.versions.policy import ROWS

#: Maps per output on the page.
MAPS_SHOWN = 2
#: Fewest rows of a region whose coverage is given.
MIN_REGION_ROWS = 20


def figures(report: ValidationReport) -> CardBlock:
    rows = []
    for entry in report.outputs:
        unit, metrics = entry.unit, entry.metrics
        best = best_simple(entry)
        rows.append(
            (
                f"{entry.output} {ROWS[entry.rows]}",
                quantity(metrics.rmse, unit),
                quantity(metrics.p95, unit),
                quantity(metrics.max, unit),
                "–" if entry.noise_floor is None else quantity(entry.noise_floor, unit),
                "–" if best is None else f"{best}: {quantity(entry.baselines[best].rmse, unit)}",
            )
        )
    recordings = dict.fromkeys(name for entry in report.outputs for name in entry.recordings)
    text = f"On held-out rows of {report.dataset} ({', '.join(recordings)})."
    texts = (text, report.recommendation) if report.recommendation else (text,)
    return CardBlock(
        "Figures", texts, ("output", "RMSE", "95 %", "max", "sensor noise alone", "best simple model"), tuple(rows)
    )


def baselines(report: ValidationReport) -> Iterator[CardBlock]:
    """The RMSE of the network and of every simple model."""
    names = list(dict.fromkeys(name for entry in report.outputs for name in entry.baselines))
    if not names:
        return
    rows = tuple(
        (
            f"{entry.output} {ROWS[entry.rows]}",
            quantity(entry.metrics.rmse, entry.unit),
            *(quantity(entry.baselines[name].rmse, entry.unit) if name in entry.baselines else "–" for name in names),
        )
        for entry in report.outputs
    )
    yield CardBlock("Beside simple models", ("RMSE; all fitted on the same rows.",), ("output", "this version", *names), rows)


def error_maps(report: ValidationReport) -> Iterator[CardBlock]:
    """The worst bin of the first map of each output; the maps are shown on the page."""
    rows, maps = [], []
    for entry in report.outputs:
        for item in entry.maps[:MAPS_SHOWN]:
            maps.append((f"{entry.output} {ROWS[entry.rows]}", entry.unit, item))
        if entry.maps:
            first = entry.maps[0]
            a, b = first.worst
            ends = (
                f"{name} {interval(edges[k], edges[k + 1], unit)}"
                for name, unit, edges, k in zip(first.over, first.units, first.edges, (a, b), strict=True)
            )
            size, count = quantity(first.rmse[a][b], entry.unit), str(first.count[a][b])
            rows.append((f"{entry.output} {ROWS[entry.rows]}", ", ".join(ends), size, count, percent(first.explains)))
    if rows:
        header = ("output", "largest where", "RMSE there", "rows", "explained by the map")
        yield CardBlock("Where its errors are", (), header, tuple(rows), maps=tuple(maps))


def uncertainty(report: ValidationReport) -> Iterator[CardBlock]:
    """Coverage of its intervals, and how often it flags extrapolation."""
    rows = []
    for entry in report.outputs:
        if entry.coverage is None:
            continue
        found = entry.coverage
        crowded = [region for region in found.regions if region.count >= MIN_REGION_ROWS]
        worst = min(crowded, key=lambda region: region.covered, default=None)
        rows.append(
            (
                f"{entry.output} {ROWS[entry.rows]}",
                f"± {quantity(found.half_width, entry.unit)}",
                f"{100.0 * found.covered:.1f} %",
                "–" if worst is None else f"{worst.name}: {100.0 * worst.covered:.0f} %",
                f"{100.0 * found.flagged:.1f} %",
            )
        )
    if rows:
        level = next(entry.coverage.level for entry in report.outputs if entry.coverage is not None)
        text = (
            f"Its {100.0 * level:g} % intervals (`predict_interval`) on held-out rows, and the share of rows that it flags as "
            f"extrapolation (`inside`; of rows from the training distribution {100.0 * FALSE_FLAGS:g} %)."
        )
        header = ("output", "half width, median", "coverage", "lowest coverage", "flagged")
        yield CardBlock("Uncertainty", (text,), header, tuple(rows))


def best_simple(entry: OutputReport) -> str | None:
    return min(entry.baselines, key=lambda name: entry.baselines[name].rmse, default=None)
