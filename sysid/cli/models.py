"""``sysid models``: list, show, promote, compare, export and repair model versions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from sysid.cli.datasets import ReferenceGroup
from sysid.cli.output import PATH, Printer, json_option
from sysid.errors import SettingsError, StoreError

if TYPE_CHECKING:
    from sysid.model_versions import ModelVersions
    from sysid.registry import DamagedModel, ModelVersion, Registry

RESIDUAL_NOTE = "contains unnamed_residual: a bounded network fitted to the recordings, without a physical cause."
ANYWAY = "'WHY'"


@click.group(cls=ReferenceGroup, subcommand_metavar="[NAME[@VERSION] | VERB …]")
def models() -> None:
    """List, show and manage the versions of networks, plants and policies.

    `sysid models` lists them, `sysid models NAME[@VERSION]` shows one. With --json FILE the result is written as JSON as well.
    """


@models.command()
@click.argument("reference", metavar="[NAME[@VERSION]]", required=False)
@click.option("--kind", help="actuator, history, motion, forward, plant or policy only.")
@json_option
@click.pass_obj
def show(location: str, reference: str | None, kind: str | None, out: Printer) -> None:
    """List model versions, or show one."""
    from sysid.registry import DamagedModel

    registry = _registry(location)
    if reference is not None:
        from sysid.cli.version_tables import show_model

        version = registry.find(reference)
        difference = ""
        if "machine.diff" in version.sha256:
            difference = registry.load(version.reference).files["machine.diff"].decode("utf-8", "replace")
        show_model(out, version, difference)
        if _has_residual(version):
            out.line(RESIDUAL_NOTE)
        out.json({"schema": 1, **version.to_json()})
        return
    found = registry.survey(kind)
    versions = [entry for entry in found if not isinstance(entry, DamagedModel)]
    damaged = [entry for entry in found if isinstance(entry, DamagedModel)]
    rows = [{"reference": entry.reference, "damage": str(entry.error)} for entry in damaged]
    out.json({"schema": 1, "models": [version.to_json() for version in versions], "damaged": rows})
    if not found:
        out.line(f"No models in {location} yet: sysid fit creates networks, sysid gap creates plants.")
        return
    out.table(("model", "kind", "made from", "aliases", "content"), [_row(entry) for entry in found])
    if any(map(_has_residual, versions)):
        out.line(f"* {RESIDUAL_NOTE}")
    for entry in damaged:
        out.line(f"damaged: {entry.error}")


def _row(entry: ModelVersion | DamagedModel) -> tuple[str, ...]:
    from sysid.registry import DamagedModel

    if isinstance(entry, DamagedModel):
        return entry.reference, "damaged", "–", "", ""
    kind = f"{entry.kind}{' *' if _has_residual(entry) else ''}"
    made_from = str(entry.lineage.get("dataset", "–"))
    return entry.reference, kind, made_from, ", ".join(entry.aliases), entry.digest[:12]


@models.command()
@click.option("--accept", is_flag=True, help="Accept what was changed by hand.")
@json_option
@click.pass_obj
def repair(location: str, accept: bool, out: Printer) -> None:
    """Repair the registry: migrate old tables, rebuild lost ones from the model files.

    Aliases and figures that were changed by hand are restored. Exit status 2 if something cannot be restored.
    """
    from dataclasses import asdict

    found = _registry(location).repair(accept)
    for line in found.done:
        out.line(line)
    if not found.done and not found.left:
        out.line("The registry is valid: nothing to repair.")
    out.json({"schema": 1, **asdict(found)})
    if found.left:
        raise StoreError(f"model registry of {location}", " ".join(found.left))


@models.command()
@click.argument("reference", metavar="NAME@VERSION")
@click.option("--policy", type=PATH, metavar="P.toml", help="Conditions for a network. Default: no worse than the champion.")
@click.option("--on", "dataset", metavar="DATASET", help="Use its held-out rows. Default: that of the fit.")
@click.option("--anyway", "word", default="", metavar="WHY", help="Promote it regardless of the checks; WHY is recorded.")
@json_option
@click.pass_obj
def promote(location: str, reference: str, policy: Path | None, dataset: str | None, word: str, out: Printer) -> None:
    """Make this version the one that the name alone means, if it passes.

    Networks are evaluated by a policy, plants by the proof that `sysid gap --add` recorded with them. The decision is stored
    with the version. Exit status 2 if it is refused.
    """
    from dataclasses import asdict

    from sysid.cli.version_tables import show_promotion
    from sysid.versions import load_policy

    if "@" not in reference:
        raise SettingsError("sysid models promote", reference, "one version, as in autolog@1")
    rules = load_policy(policy)
    found = _versions(location).promote(reference, rules, policy, word.strip(), dataset)
    show_promotion(out, found, word.strip())
    out.json({"schema": 1, "promoted": found.promoted, "word": word.strip(), **asdict(found)})
    if not found.promoted:
        remedy = f"To promote it regardless: sysid models promote {found.version} --anyway {ANYWAY}"
        failed = [check for check in found.checks if check.status == "failed"]
        result = failed[0].text if len(failed) == 1 else f"{len(failed)} of {len(found.checks)} conditions do not hold"
        raise StoreError(found.version, f"not promoted: {result if failed else found.reason}", "a version that passes", remedy)


@models.command()
@click.argument("reference", metavar="NAME[@VERSION]")
@json_option
@click.pass_obj
def lineage(location: str, reference: str, out: Printer) -> None:
    """Show the sources of a version, to the raw files, and what was made from it."""
    from sysid.cli.version_tables import show_model_lineage

    found = _versions(location).lineage(reference)
    show_model_lineage(out, found)
    out.json(found.to_json())


@models.command(name="diff")
@click.argument("before", metavar="A")
@click.argument("after", metavar="B")
@json_option
@click.pass_obj
def diff_two(location: str, before: str, after: str, out: Printer) -> None:
    """Show how version B differs from version A.

    Predictions over the common range, recipe, dataset, figures, files, and the geometry of forward models.
    """
    from sysid.cli.version_tables import show_model_diff

    found = _versions(location).diff(before, after)
    show_model_diff(out, found)
    out.json(found.to_json())


@models.command()
@click.argument("reference", metavar="NAME[@VERSION]")
@click.option("--out", "target", type=PATH, metavar="DIR", help="Default: WORKSPACE/exports/NAME@V.")
@click.option("--precision", type=click.Choice(["float32", "float64"]), default="float32", show_default=True)
@json_option
@click.pass_obj
def export(
    location: str,
    reference: str,
    target: Path | None,
    precision: Literal["float32", "float64"],
    out: Printer,
) -> None:
    """Write a network as ONNX, and keep it only if it predicts the same."""
    from dataclasses import asdict

    from sysid.cli.version_tables import show_exported

    folder, files = _versions(location).export(reference, target, precision)
    show_exported(out, folder, files)
    out.json({"schema": 1, "folder": str(folder), "files": [asdict(entry) for entry in files]})


@models.command()
@click.argument("reference", metavar="NAME[@VERSION]")
@click.option("--out", type=PATH, metavar="F", help="F.md or F.html; else both in cards/.")
@click.pass_obj
def card(location: str, reference: str, out: Path | None) -> None:
    """Write the card of a version: purpose, errors, limits, lineage, and how to load it."""
    from sysid.names import check_file_name
    from sysid.reports.model_pages import card_page
    from sysid.reports.pages import write_page

    if out is not None and out.suffix not in (".md", ".html"):
        raise SettingsError(f"--out {out}", f"suffix {out.suffix!r}", ".md or .html")
    versions = _versions(location)
    found = versions.card(reference)
    names = [f"cards/{check_file_name(found.title, 'card')}{suffix}" for suffix in (".md", ".html")]
    for path in (out,) if out is not None else tuple(map(versions.workspace.output, names)):
        text = found.markdown() if path.suffix == ".md" else card_page(found)
        Printer().line(str(write_page(path, text)))


def _registry(location: str) -> Registry:
    """The registry alone: the workspace imports everything that it may store."""
    from sysid.location import checked_location, local_folder
    from sysid.registry import Registry

    return Registry(local_folder(checked_location(location)))


def _versions(location: str) -> ModelVersions:
    from sysid.model_versions import ModelVersions
    from sysid.workspace import open_workspace

    return ModelVersions(open_workspace(location))


def _has_residual(version: ModelVersion) -> bool:
    """Whether a plant holds a residual network beside its effects."""
    return version.kind == "plant" and "residuals.safetensors" in version.sha256
