"""What is printed of model versions: a promotion, a lineage, two that differ, an export, a drift."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sysid.cli.version_tables import model_line, show_chain, show_changes, show_names

if TYPE_CHECKING:
    from pathlib import Path

    from sysid.cli.output import Printer
    from sysid.registry import Promotion
    from sysid.versions import DriftReport, Exported, ModelDiff, ModelLineage

#: Parameters of a geometry that are listed, those that moved most first.
MAX_PARAMETERS = 20


def show_promotion(out: Printer, found: Promotion, word: str = "") -> None:
    """What was asked, and what the name alone means now."""
    name = found.version.partition("@")[0]
    for check in found.checks:
        out.line(f"  {check.status:<8}  {check.text}")
    if not found.promoted:
        meant = f"`{name}` alone goes on meaning {found.current}" if found.current else "nothing of this name is promoted"
        out.line(f"Not promoted; {meant}.")
        return
    if word:
        out.line(f"By an explicit word: {word}")
    instead = f" instead of {found.previous}" if found.previous not in ("", found.version) else ""
    out.line(f"`{name}` alone means {found.version} from now on{instead}.")


def show_model_lineage(out: Printer, found: ModelLineage) -> None:
    """The chain of a model version: what it was made from, to the raw files, and what came of it."""
    known = f"  ({', '.join(found.aliases)})" if found.aliases else ""
    out.line(f"{found.model}{known}  {found.kind}  {found.digest}")
    for parent in found.parents:
        out.line(model_line("made of", parent))
    if found.missing:
        out.line(f"dataset   {found.dataset or '–'}: {found.missing}")
    if found.source is not None:
        out.line()
        show_chain(out, found.source)
    out.line()
    for child in found.children:
        out.line(model_line("used by", child))
    for use in found.uses:
        out.line(f"used by   {use.what} on {use.dataset}: {use.how}")
    if not found.children and not found.uses:
        out.line("used by   nothing was made from it")


def show_model_diff(out: Printer, found: ModelDiff) -> None:
    """How two versions differ, what weighs most first."""
    from sysid.versions.outputs import shown

    out.line(f"{found.before} → {found.after}")
    if found.empty:
        out.line("The same: nothing differs." if found.same_content else "Nothing differs but the way they were made.")
        return
    for word, outputs in (("added", found.outputs.added), ("removed", found.outputs.removed)):
        for output in outputs:
            out.line(f"output {word}: {output}")
    rows: list[tuple[str, ...]] = []
    for entry in found.predictions:
        at = ", ".join(f"{signal} {value:.4g}" for signal, value in entry.at.items())
        if not entry.points:
            at = "the fitted ranges do not meet"
        rows.append((entry.output, shown(entry.largest, entry.unit), shown(entry.rms, entry.unit), at))
    if rows:
        out.table(("prediction", "largest difference", "rms", "largest at"), rows, right=(1, 2))
    show_changes(out, "recipe", found.recipe)
    show_changes(out, "made from", found.lineage)
    show_changes(out, "figure", found.figures)
    show_names(out, "file", found.files)
    only = [change for change in found.geometry if not math.isfinite(change.sigmas)]
    if only:
        who = found.after if math.isnan(only[0].before) else found.before
        out.line(f"geometry: {len(only)} parameters of {who} alone")
    largest = sorted((change for change in found.geometry if math.isfinite(change.sigmas)), key=lambda change: -change.sigmas)
    rows = [
        (change.parameter, shown(change.before, change.unit), shown(change.after, change.unit), f"{change.sigmas:.1f}")
        for change in largest[:MAX_PARAMETERS]
    ]
    if rows:
        out.table(("geometry", "before", "after", "differs by sigmas"), rows, right=(1, 2, 3))
    if len(largest) > MAX_PARAMETERS:
        out.line(f"geometry: {len(largest) - MAX_PARAMETERS} more differ (--json FILE has them all)")


def show_exported(out: Printer, folder: Path, files: tuple[Exported, ...]) -> None:
    """The files, and how closely each agrees with the version itself."""
    rows = [
        (
            str(folder / entry.file),
            ", ".join(entry.inputs),
            ", ".join(entry.outputs),
            f"{max(entry.largest):.2g}",
            f"{max(entry.allowed):.2g}",
        )
        for entry in files
    ]
    header = ("file", "from", "to", "differs by", "rounding allows")
    out.table(header, rows, right=(3, 4))
    points, kind = files[0].points, files[0].precision
    out.line(
        f"Run by ONNX Runtime at {points} random inputs, half of them beyond the fitted range; numbers are {kind}, SI units."
    )


def show_drift(out: Printer, found: DriftReport) -> None:
    """Whether a version still fits, output by output."""
    from sysid.reports.display import percent
    from sysid.versions.drift import OUTSIDE_SHARE
    from sysid.versions.outputs import shown

    rows = []
    for entry in found.outputs:
        low, high = entry.ratio95
        compared = entry.verdict != "not comparable"
        rows.append(
            (
                entry.output,
                entry.rows,
                str(entry.inside),
                shown(entry.own_rmse, entry.unit),
                shown(entry.own_worst, entry.unit),
                shown(entry.rmse, entry.unit),
                f"{entry.ratio:.2f} ({low:.2f} … {high:.2f})" if compared else "–",
                ("< 0.001" if entry.p_value < 1e-3 else f"{entry.p_value:.3f}") if compared else "–",
                entry.verdict,
            )
        )
    here = (f"rmse, {found.own}", "its worst recording", f"rmse, {found.dataset}", "ratio (95 %)")
    out.table(("output", "rows", "compared", *here, "by chance", ""), rows, right=(2, 3, 4, 5, 6, 7))
    for item in found.inputs:
        if item.outside > OUTSIDE_SHARE:
            (low, high), (least, most) = item.fitted, item.found
            out.line(
                f"{item.signal} ({item.rows}): {percent(item.outside)} of the rows beyond the fitted {low:.4g} … {high:.4g}"
                f" {item.unit}; they reach {least:.4g} … {most:.4g}"
            )
    if found.known:
        out.line(f"Left out, since {found.own} holds them too: {', '.join(found.known)}")
    grown = [f"{entry.output} ({entry.rows})" for entry in found.outputs if entry.verdict == "drifted"]
    said = {
        "fits": "fits: its errors are what they were, inside the ranges that it was fitted on.",
        "beyond its ranges": "fits where it was fitted, but is asked beyond its ranges. Fit it again with these recordings.",
        "drifted": f"no longer fits: larger errors in {', '.join(grown)}, beyond chance.",
        "not comparable": "cannot be evaluated: too few rows of its own or of the new ones.",
    }[found.verdict]
    out.line(f"{found.model} on {found.dataset} {said}")
