"""Console text of dataset versions: differences, lineage, vacuum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from sysid.cli.output import Printer
from sysid.display import size_text

if TYPE_CHECKING:
    from sysid.datasets import DatasetDiff, Lineage, VacuumResult
    from sysid.datasets.versions.diff import NameChanges, ValueChange
    from sysid.registry import ModelVersion
    from sysid.versions.lineage import RelatedVersion

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
    if rows:
        out.table(("recording", "clock of", "offset [s]", "skew [ppm]", "mid-recording [ms]", ""), rows, right=(2, 3, 4))
    rows = []
    for item in sorted(found.tables, key=lambda item: (item.recording, item.signal)):
        lengths = str(item.rows[0]) if item.rows[0] == item.rows[1] else f"{item.rows[0]} → {item.rows[1]}"
        missing = str(item.missing[0]) if item.missing[0] == item.missing[1] else f"{item.missing[0]} → {item.missing[1]}"
        numbers = (f"{item.largest:.3g}", f"{item.rms:.3g}") if item.compared else ("–", "–")
        rows.append((item.recording, item.signal, lengths, missing, *numbers, item.unit))
    if rows:
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
            state = f"{clock.offset_s:+.6f} s, {clock.skew_ppm:+.1f} ppm" if clock.applied else f"not aligned: {clock.reason}"
            out.line(f"  clock     {clock.stream} of {clock.recording}: {state}")
        settings = ", ".join(f"{name} {value}" for name, value in part.settings.items() if name != "streams")
        out.line(f"  resampled {settings or 'with settings that were not recorded'}")
        software = ", ".join(f"{name} {version}" for name, version in part.software.items())
        out.line(f"  by        sysid {part.sysid}, ingest {part.ingest}{', ' + software if software else ''}, {part.created}")
        for place, digests in part.tables.items():
            out.line(f"  table     {', '.join(digest[:12] for digest in digests) or '–'}  {place}")
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
