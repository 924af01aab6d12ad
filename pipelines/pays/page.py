"""Figure and tables of the comparison: errors over the length of the data, and from which length on a network is better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from committed import markdown
from log_picture import COLOURS, Curve, Panel, picture
from pays.models import DESCRIBED, FOUND, MOTION_NETWORK, RECURRENT_NETWORK, RESIDUAL

Row = Mapping[str, Any]
#: Factor and unit of what is shown; the values of the hydraulic actuator have the unit of their file.
SHOWN = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "": (1.0, "units of the file")}
MODELS = (DESCRIBED, FOUND, RESIDUAL, MOTION_NETWORK, RECURRENT_NETWORK)
#: With seeds, and compared with the plant.
NETWORKS = (RESIDUAL, MOTION_NETWORK, RECURRENT_NETWORK)
FLOOR = "noise floor"
RUNS = {"whole": "whole recordings", "pieces": "2 s"}


def errors_of(entry: Row, model: str, run: str) -> list[float]:
    """Error of each seed [SI]; one value of a model without seeds, none where it could not be fitted."""
    found = entry.get(model)
    return [] if found is None else [item[run] for item in (found if isinstance(found, list) else [found])]


def accepted(entry: Row) -> int:
    """Seeds of which the gap workflow accepted the residual network; without one the plant is that with the effects."""
    return sum(any(item["accepted"] for item in items) for items in entry.get("networks", []))


def pays_from(machine: Row, model: str, run: str) -> float | None:
    """The least length [s] from which on every seed is better than the plant with the effects, at this and greater lengths.

    Lengths on which the gap workflow refuses to work do not count.
    """
    least = None
    for entry in reversed([entry for entry in machine["lengths"] if entry[FOUND] is not None]):
        errors = errors_of(entry, model, run)
        if not errors or max(errors) >= entry[FOUND][run]:
            break
        least = entry["seconds"]
    return least


def figure(result: Row) -> str:
    """A panel for each machine: errors of free runs over whole test recordings, the median of the seeds in their range."""
    panels = []
    for title, machine in result["machines"].items():
        factor, unit = SHOWN[machine["unit"]]
        curves = []
        for colour, model in zip((COLOURS[5], COLOURS[0], COLOURS[1], COLOURS[2], COLOURS[3]), MODELS, strict=True):
            shown = [entry for entry in machine["lengths"] if model != RESIDUAL or accepted(entry)]
            points = [(e["seconds"], [factor * v for v in errors_of(e, model, "whole")]) for e in shown]
            points = [(x, values) for x, values in points if values]
            x, y = [x for x, _ in points], [median(values) for _, values in points]
            band = [(min(values), max(values)) for _, values in points] if model in NETWORKS else ()
            if points:
                curves.append(Curve(model, colour, x, y, dashed=model == DESCRIBED, band=band))
        ticks = {entry["seconds"]: duration(entry["seconds"]) for entry in machine["lengths"]}
        levels = {FLOOR: factor * machine["lengths"][-1]["noise_floor"]}
        panels.append(Panel(f"{title}: error of the free run [{unit}]", curves, ticks, levels))
    return picture(panels)


def tables(result: Row) -> str:
    """What the page shows: from when on a network is better, all errors, rate and history."""
    parts = [markdown(("machine", "free run over", *(f"{model} better from" for model in NETWORKS)), _summary(result), "lllll")]
    for title, machine in result["machines"].items():
        factor, unit = SHOWN[machine["unit"]]
        header = (f"{title} [{unit}]", *MODELS, "effects in the repair")
        parts.append(markdown(header, [_line(entry, factor) for entry in machine["lengths"]], "lrrrrrl"))
        parts.append(
            f"Test: {machine['test_seconds']:.0f} s of `{machine['signal']}`, standard deviation "
            f"{factor * machine['deviation']:.3g}, noise floor {factor * machine['lengths'][-1]['noise_floor']:.2g}."
        )
    if result["rate_and_history"]:
        parts.append(_varied(result))
    return "\n\n".join(parts)


def _summary(result: Row) -> list[tuple[str, ...]]:
    found = []
    for title, machine in result["machines"].items():
        for run, name in RUNS.items():
            least = [pays_from(machine, model, run) for model in NETWORKS]
            found.append((title, name, *("–" if seconds is None else duration(seconds) for seconds in least)))
    return found


def _line(entry: Row, factor: float) -> tuple[str, ...]:
    cells = [
        " / ".join(_range([factor * v for v in errors_of(entry, model, run)]) for run in RUNS)
        if errors_of(entry, model, "whole")
        else "–"
        for model in MODELS
    ]
    seeds = len(entry.get("networks", []))
    if seeds and not accepted(entry):
        cells[MODELS.index(RESIDUAL)] = "none accepted"
    elif accepted(entry) < seeds:
        cells[MODELS.index(RESIDUAL)] += f", {accepted(entry)} of {seeds} accepted"
    named = {effect["name"] for effect in entry.get("effects", [])}
    written = ", ".join(f"**{name}**" if name in named else name for name in entry.get("written", []))
    return (duration(entry["seconds"]), *cells, "too short" if entry.get(FOUND) is None else written or "none")


def _varied(result: Row) -> str:
    rows = result["rate_and_history"]
    steps, spans = (list(dict.fromkeys(row[key] for row in rows)) for key in ("step", "span"))
    table = []
    for step in steps:
        cells: list[Row] = [next((row for row in rows if (row["step"], row["span"]) == (step, span)), {}) for span in spans]
        table.append((f"{1e3 * step:g} ms", *(_cell(row) for row in cells)))
    return markdown(("step of the network", *(f"history {span:g} s" for span in spans)), table, "l")


def _cell(row: Row) -> str:
    errors = [[1e3 * v for v in errors_of(row, MOTION_NETWORK, run)] for run in RUNS]
    return " / ".join(_range(values) for values in errors) if errors[0] else "–"


def _range(values: Sequence[float]) -> str:
    """Median of the seeds, and their range."""
    if len(set(values)) == 1:
        return f"{values[0]:.3g}"
    return f"{median(values):.3g} ({min(values):.3g}–{max(values):.3g})"


def duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.2g} min"
