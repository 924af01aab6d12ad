"""Console output of dataset and model versions: differences, lineage, vacuum; promotion, one version, export, drift."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sysid.display import NOTHING, interval, minute, percent, quantity, size_text
from sysid.names import dotted

if TYPE_CHECKING:
    from pathlib import Path

    from sysid.cli.output import Printer
    from sysid.datasets import DatasetDiff, Lineage, VacuumResult
    from sysid.datasets.versions.diff import NameChanges, ValueChange
    from sysid.registry import ModelVersion, Promotion
    from sysid.versions import DriftReport, ExportedFile, ModelDiff, ModelLineage
    from sysid.versions.lineage import RelatedVersion

#: Entries of a plant's lineage that are too long for the console, or repeat its effects.
IN_JSON = ("proof", "notes", "named", "software", "dataset_digest")
#: Largest number of listed parameters of a geometry.
MAX_PARAMETERS = 20
#: Largest number of listed figures; JSON has all.
MAX_FIGURES = 20


def show_diff(out: Printer, found: DatasetDiff) -> None:
    """Differences of two versions, the largest kinds first."""
    out.line(f"{found.before} → {found.after}")
    if found.empty:
        out.line("No differences." if found.same_content else "Equal content, created in different ways.")
        return
    show_names(out, "recording", found.recordings)
    show_names(out, "raw file", found.sources)
    show_names(out, "signal", found.signals)
    for change in found.units:
        out.line(f"unit of {change.what}: [{change.before}] → [{change.after}]")
    for change in found.splits:
        out.line(f"role of {change.what}: {change.before or 'none'} → {change.after or 'none'}")
    for text in found.texts.values():
        out.block(text)
    show_changes(out, "made with", found.settings)
    rows: list[tuple[str, ...]] = []
    for clock in found.clocks:
        offset, skew = (f"{a:+.6g} → {b:+.6g}" for a, b in (clock.offset_s, clock.skew_ppm))
        applied = "" if all(clock.applied) else f"{_applied(clock.applied[0])} → {_applied(clock.applied[1])}"
        rows.append((clock.recording, clock.stream, offset, skew, f"{1e3 * clock.mid_shift_s:+.3f}", applied))
    out.table(("recording", "clock of", "offset [s]", "skew [ppm]", "mid-recording [ms]", ""), rows, right=(2, 3, 4))
    rows = []
    for item in sorted(found.tables, key=lambda item: (item.recording, item.signal)):
        lengths = str(item.rows[0]) if item.rows[0] == item.rows[1] else f"{item.rows[0]} → {item.rows[1]}"
        missing = str(item.missing[0]) if item.missing[0] == item.missing[1] else f"{item.missing[0]} → {item.missing[1]}"
        numbers = (f"{item.largest:.3g}", f"{item.rms:.3g}") if item.compared else (NOTHING, NOTHING)
        rows.append((item.recording, item.signal, lengths, missing, *numbers, item.unit))
    out.table(("recording", "signal", "rows", "missing", "largest", "rms", "unit"), rows, right=(2, 3, 4, 5))
    show_changes(out, "quality", found.quality)


def _applied(applied: bool) -> str:
    return "aligned" if applied else "not aligned"


def show_names(out: Printer, what: str, names: NameChanges) -> None:
    for word, items in (("added", names.added), ("removed", names.removed), ("changed", names.changed)):
        if items:
            out.line(f"{what} {word}: {', '.join(items)}")


def show_changes(out: Printer, what: str, changes: Sequence[ValueChange]) -> None:
    for change in changes[:MAX_FIGURES]:
        out.line(f"{what} {change.what}: {_text(change.before)} → {_text(change.after)}")
    if len(changes) > MAX_FIGURES:
        out.line(f"{what}: {len(changes) - MAX_FIGURES} more differ (--json FILE has them all)")


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "none" if value is None else str(value)


def show_lineage(out: Printer, found: Lineage, models: Sequence[ModelVersion]) -> None:
    """The lineage of a version, from the raw files to the models."""
    show_chain(out, found)
    for model in models:
        out.line(model_line("model", model))
    if not models:
        out.line("model     none was made from it")


def show_chain(out: Printer, found: Lineage) -> None:
    """The lineage of a dataset version, to its raw files."""
    from sysid.reports.dataset_texts import clock_text

    out.line(f"{found.dataset}  {found.digest}  made {found.created}")
    for step in found.steps:
        gone = "" if step.there else ", removed since"
        out.line(f"  by {step.by} from {step.reference}  {step.digest[:12]}{gone}")
    for name, digest in found.machine.items():
        out.line(f"  {name}  {digest[:12]}")
    for number, part in enumerate(found.parts, start=1):
        out.line()
        out.line(f"part {number} of {len(found.parts)}: {', '.join(part.recordings)}")
        for source in part.sources:
            out.line(f"  raw       {source.sha256[:12]}  {source.path}  {source.size} bytes")
        out.line(f"  recipe    {part.recipe_sha256[:12] or 'none: columns have canonical names'}")
        for clock in part.clocks:
            out.line(f"  clock     {clock.stream} of {clock.recording}: {clock_text(clock)}")
        settings = ", ".join(f"{name} {value}" for name, value in part.settings.items() if name != "streams")
        out.line(f"  resampled {settings or 'with settings that were not recorded'}")
        software = ", ".join(f"{name} {version}" for name, version in part.software.items())
        out.line(f"  by        sysid {part.sysid}, ingest {part.ingest}{', ' + software if software else ''}, {part.created}")
        for place, digests in part.tables.items():
            out.line(f"  table     {', '.join(digest[:12] for digest in digests) or NOTHING}  {place}")
    roles: dict[str, list[str]] = {}
    for recording, role in found.splits.items():
        roles.setdefault(role, []).append(recording)
    out.line()
    for role, names in roles.items():
        out.line(f"{role:<9} {', '.join(names)}")


def model_line(role: str, model: ModelVersion | RelatedVersion) -> str:
    """One model version in a lineage, with its role."""
    aliases = f"  ({', '.join(model.aliases)})" if model.aliases else ""
    return f"{role:<9} {model.reference}  {model.kind}  {model.digest[:12]}{aliases}"


def show_vacuumed(out: Printer, found: VacuumResult, registry: str, hint: bool) -> None:
    """What was removed and kept; ``hint`` adds how to remove it."""
    for item in found.removed:
        out.line(f"{'would remove' if found.dry_run else 'removed'} {item.what}  {size_text(item.size)}")
    for kept in found.kept:
        out.line(f"kept {kept.what}: {kept.reason}")
    if not found.removed and not found.kept:
        out.line("Nothing to remove.")
        return
    out.line(f"{size_text(found.size)} {'would be' if found.dry_run else 'are'} freed. Model registry: {registry}.")
    if hint and found.removed:
        out.line("Nothing was removed yet: the same command with --yes removes it.")


# -- models ----------------------------------------------------------------------------------------------------------------


def show_promotion(out: Printer, found: Promotion, word: str = "") -> None:
    """The conditions, and the champion now."""
    name = found.version.partition("@")[0]
    for check in found.checks:
        out.line(f"  {check.status:<8}  {check.text}")
    if not found.promoted:
        champion = f"`{name}` alone still means {found.current}" if found.current else "no version of this name is promoted"
        out.line(f"Not promoted; {champion}.")
        return
    if word:
        out.line(f"Promoted regardless of the checks: {word}")
    instead = f" instead of {found.previous}" if found.previous not in ("", found.version) else ""
    out.line(f"`{name}` alone now means {found.version}{instead}.")


def show_model_lineage(out: Printer, found: ModelLineage) -> None:
    """The lineage of a model version: its sources, to the raw files, and what was made from it."""
    known = f"  ({', '.join(found.aliases)})" if found.aliases else ""
    out.line(f"{found.model}{known}  {found.kind}  {found.digest}")
    for parent in found.parents:
        out.line(model_line("made of", parent))
    if found.missing:
        out.line(f"dataset   {found.dataset or NOTHING}: {found.missing}")
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
    """Differences of two versions, predictions first."""
    from sysid.figures import Table
    from sysid.registry.effect_changes import CHANGES, change_cells
    from sysid.reports.result_figures import PREDICTIONS, prediction_cells

    out.line(f"{found.before} → {found.after}")
    if found.empty:
        out.line("No differences." if found.same_content else "Equal content, created in different ways.")
        return
    for word, outputs in (("added", found.outputs.added), ("removed", found.outputs.removed)):
        for output in outputs:
            out.line(f"output {word}: {output}")
    out.show(Table(PREDICTIONS, [prediction_cells(entry) for entry in found.predictions], (1, 2)))
    out.show(Table(CHANGES, [change_cells(change) for change in found.effects], (3, 4)))
    show_changes(out, "recipe", found.recipe)
    own = [change for change in found.lineage if change.what.split(".")[0] not in IN_JSON]
    show_changes(out, "made from", own)
    if len(own) < len(found.lineage):
        more = len(found.lineage) - len(own)
        out.line(f"{more} values of proof, near misses, software and digests differ too (--json FILE has them all)")
    show_changes(out, "figure", found.figures)
    show_names(out, "file", found.files)
    only = [change for change in found.geometry if not math.isfinite(change.sigmas)]
    if only:
        who = found.after if math.isnan(only[0].before) else found.before
        out.line(f"geometry: {len(only)} parameters only in {who}")
    largest = sorted((change for change in found.geometry if math.isfinite(change.sigmas)), key=lambda change: -change.sigmas)
    rows = [
        (change.parameter, quantity(change.before, change.unit), quantity(change.after, change.unit), f"{change.sigmas:.1f}")
        for change in largest[:MAX_PARAMETERS]
    ]
    out.table(("geometry", "before", "after", "differs by sigmas"), rows, right=(1, 2, 3))
    if len(largest) > MAX_PARAMETERS:
        out.line(f"geometry: {len(largest) - MAX_PARAMETERS} more differ (--json FILE has them all)")


def show_model(out: Printer, version: ModelVersion, difference: str) -> None:
    """One version: what it was made from, its held-out figures, effects, recipe and decisions.

    Args:
        difference: its change of ``machine.toml``; empty without one.
    """
    from sysid.figures import stored_errors
    from sysid.registry.effect_changes import change_cells, effect_changes
    from sysid.registry.promotion import decision_row

    known = f"  ({', '.join(version.aliases)})" if version.aliases else ""
    out.line(f"{version.reference}{known}  {version.kind}  {version.digest}")
    out.line(f"made      {minute(version.created_ms)} UTC")
    for key, value in version.lineage.items():
        if key not in ("recipe", "effects", "dataset_digest") and not isinstance(value, Mapping | list):
            out.line(f"{key:<9} {value}")
    recipe = version.lineage.get("recipe")
    for key, value in sorted(_own_part(recipe, version.kind).items()) if isinstance(recipe, Mapping) else ():
        out.line(f"recipe    {key} = {value}")
    rows = [(error.output, error.rows, *error.texts) for error in stored_errors(version.metrics)]
    if rows:
        out.table(("held out", "rows", "rmse", "95 %", "max"), rows, right=(2, 3, 4))
    else:
        for name, figure in version.metrics.items():
            out.line(f"{name} = {figure:.6g}")
    effects = effect_changes({}, version.lineage)
    if effects:
        columns = [(*cells[:3], *cells[4:]) for cells in map(change_cells, effects)]
        out.table(("effect", "on", "parameter", "value", "95 % interval"), columns, right=(3,))
    if difference:
        out.block(difference)
    for decision in version.decisions:
        when, what, by, why = decision_row(decision)
        out.line(f"{when} UTC  {what}  ({by}): {why}")


def _own_part(recipe: Mapping[str, Any], kind: str) -> dict[str, str]:
    """The entries of a recipe that concern a kind of model: its table and what belongs to no kind."""
    from sysid.registry import KINDS

    table = "actuator" if kind == "history" else kind
    own = {key: value for key, value in recipe.items() if key == table or key not in KINDS}
    texts = {key: ", ".join(map(str, value)) if isinstance(value, list) else str(value) for key, value in dotted(own)}
    return {key.removeprefix(f"{table}."): text for key, text in texts.items()}


def show_exported(out: Printer, folder: Path, files: tuple[ExportedFile, ...]) -> None:
    """The files, and their agreement with the version."""
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
    header = ("file", "from", "to", "difference", "allowed")
    out.table(header, rows, right=(3, 4))
    points, kind = files[0].points, files[0].precision
    out.line(f"Evaluated by ONNX Runtime at {points} random inputs, half of them beyond the fitted range; {kind}, SI units.")


def show_drift(out: Printer, found: DriftReport) -> None:
    """The test for drift of each output."""
    from sysid.versions.drift import OUTSIDE_SHARE

    rows = []
    for entry in found.outputs:
        low, high = entry.ratio95
        compared = entry.verdict != "not comparable"
        rows.append(
            (
                entry.output,
                entry.rows,
                str(entry.inside),
                quantity(entry.own_rmse, entry.unit),
                quantity(entry.own_worst, entry.unit),
                quantity(entry.rmse, entry.unit),
                f"{entry.ratio:.2f} ({low:.2f} … {high:.2f})" if compared else NOTHING,
                ("< 0.001" if entry.p_value < 1e-3 else f"{entry.p_value:.3f}") if compared else NOTHING,
                entry.verdict,
            )
        )
    here = (f"rmse, {found.own}", "its worst recording", f"rmse, {found.dataset}", "ratio (95 %)")
    out.table(("output", "rows", "compared", *here, "p-value", ""), rows, right=(2, 3, 4, 5, 6, 7))
    for item in found.inputs:
        if item.outside > OUTSIDE_SHARE:
            fitted, measured = (interval(*ends, item.unit) for ends in (item.fitted, item.found))
            share = f"{percent(item.outside)} of the rows beyond the fitted {fitted}"
            out.line(f"{item.signal} ({item.rows}): {share}; the new range is {measured}")
    if found.known:
        out.line(f"Left out, because they are also in {found.own}: {', '.join(found.known)}")
    grown = [f"{entry.output} ({entry.rows})" for entry in found.outputs if entry.verdict == "drifted"]
    verdict = {
        "fits": "fits: inside its ranges its errors have not grown significantly.",
        "beyond its ranges": "fits inside its ranges, but recordings exceed them. Fit it again with these recordings.",
        "drifted": f"no longer fits: significantly larger errors in {', '.join(grown)}.",
        "not comparable": "cannot be evaluated: too few rows on either side.",
    }[found.verdict]
    out.line(f"{found.model} on {found.dataset} {verdict}")
