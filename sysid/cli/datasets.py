"""``sysid datasets``: list, show, compare and manage dataset versions."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sysid.cli.dataset_tables import show_dataset
from sysid.cli.output import PATH, Printer, json_option, long_arrays_beside
from sysid.errors import SettingsError, StoreError

if TYPE_CHECKING:
    from sysid.datasets import Dataset, Store


class ReferenceGroup(click.Group):
    """A group whose first argument may be a reference instead of a verb: ``sysid datasets NAME`` is ``… show NAME``.

    Its help lists the options of ``show`` too, since they are given without the verb.
    """

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        shown = self.commands["show"]
        options = [entry for entry in shown.params if isinstance(entry, click.Option)]
        records = [entry.get_help_record(click.Context(shown)) for entry in options]
        with formatter.section("Options of the list, and of NAME[@VERSION]"):
            formatter.write_dl([record for record in records if record is not None])
        super().format_options(ctx, formatter)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args or (args[0] not in self.commands and args[0] not in ctx.help_option_names):
            args = ["show", *args]
        return super().parse_args(ctx, args)


@click.group(cls=ReferenceGroup, subcommand_metavar="[NAME[@VERSION] | VERB …]")
def datasets() -> None:
    """List, show, compare and manage dataset versions.

    `sysid datasets` lists them, `sysid datasets NAME[@VERSION]` shows one, with --quality its coverage and excitation. With
    --json FILE the result is written as JSON as well.
    """


@datasets.command()
@click.argument("reference", metavar="[NAME[@VERSION]]", required=False)
@click.option("--quality", is_flag=True, help="Coverage, noise, and an excitation verdict for every effect.")
@json_option
@click.pass_obj
def show(location: str, reference: str | None, quality: bool, out: Printer) -> None:
    """List dataset versions, or show one."""
    if quality or reference is not None:
        long_arrays_beside(location)
    if quality:
        from sysid.cli.dataset_tables import show_quality

        show_quality(location, reference, out)
        return

    if reference is not None:
        from sysid.datasets import Store

        store = Store(location)
        dataset = store.load(reference)
        show_dataset(out, dataset)
        out.json({**describe(dataset), "tables": tables(store, dataset.reference)})
        return
    from sysid.datasets.versions.index import VersionIndex

    entries = VersionIndex(location).list()
    out.json({"schema": 1, "datasets": [_entry(entry) for entry in entries]})
    if not entries:
        out.line(f"No datasets in {location} yet: sysid ingest PATH creates one.")
        return
    rows = [
        (entry.reference, entry.machine, entry.recordings, f"{entry.seconds:.0f}", entry.created, entry.digest[:12])
        for entry in entries
        if not entry.damage
    ]
    out.table(("dataset", "machine", "recordings", "seconds", "made", "content"), rows, right=(2, 3))
    for entry in entries:
        if entry.damage:
            out.line(f"{entry.reference} cannot be read: {entry.damage}")


@datasets.command(name="diff")
@click.argument("before", metavar="A")
@click.argument("after", metavar="B")
@json_option
@click.pass_obj
def diff_versions(location: str, before: str, after: str, out: Printer) -> None:
    """Show how version B differs from version A.

    Raw files, recipe and machine, clocks, roles, signals and units, values of the tables, and figures of quality.
    """
    from sysid.cli.version_tables import show_diff
    from sysid.datasets import Store, diff

    found = diff(Store(location), before, after)
    show_diff(out, found)
    out.json(found.to_json())


@datasets.command()
@click.argument("reference", metavar="NAME[@VERSION]")
@click.option("--fit", multiple=True, metavar="GLOB", help="Recordings for the fit; may be repeated.")
@click.option("--select", multiple=True, metavar="GLOB", help="Recordings for model selection.")
@click.option("--held-out", multiple=True, metavar="GLOB", help="Recordings for the proof.")
@click.option(
    "--suggest", is_flag=True, help="Only show roles that give every axis motion in each role, beside the present ones."
)
@json_option
@click.pass_obj
def split(
    location: str,
    reference: str,
    fit: tuple[str, ...],
    select: tuple[str, ...],
    held_out: tuple[str, ...],
    suggest: bool,
    out: Printer,
) -> None:
    """Create a version with other roles of the recordings; the tables are not copied.

    Recordings that no option names keep their roles. With --suggest nothing is created: the present roles are compared with
    suggested ones, by the motion of every axis in each role.
    """
    if suggest:
        from sysid.cli.dataset_tables import show_suggestion

        if fit or select or held_out:
            raise SettingsError("sysid datasets split", "--suggest with roles", "one of them")
        show_suggestion(location, reference, out)
        return
    from sysid.datasets import Store
    from sysid.datasets.splits import with_roles

    store = Store(location)
    manifest = store.manifest(reference)
    base = f"{manifest['name']}@{manifest['version']}"
    roles = with_roles(manifest["splits"], {"fit": fit, "select": select, "held_out": held_out}, base)
    dataset = store.resplit(base, roles)
    show_dataset(out, dataset)
    out.line(f"{base} has these roles already." if dataset.reference == base else f"{dataset.reference}: the tables of {base}.")
    out.json({**describe(dataset), "base": base})


@datasets.command()
@click.argument("reference", metavar="NAME[@VERSION]")
@click.argument("folder", metavar="FOLDER", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--out", "target", required=True, metavar="DIR", type=PATH, help="A new folder.")
@json_option
@click.pass_obj
def shift(location: str, reference: str, folder: Path, target: Path, out: Printer) -> None:
    """Write a LeRobot dataset with every action as late as its motion.

    FOLDER is the LeRobot dataset that NAME was made from. Every action becomes later by the delay of the motion behind it, as
    the recordings show it; axes without one keep their actions. Statistics are computed again; all else is copied.
    """
    from sysid.cli.gap_tables import show_responses
    from sysid.datasets import Store
    from sysid.logs.lerobot import LeRobotReader
    from sysid.logs.lerobot_shift import write_shifted

    store = Store(location)
    responses = show_responses(out, store.load(reference))
    actions = {
        signal.removesuffix(".command"): str(source["field"])
        for part in store.manifest(reference)["parts"]
        for stream in tomllib.loads(part["made"]["recipe"]).get("streams", [])
        if stream.get("reader") == LeRobotReader().name
        for signal, source in stream.get("signals", {}).items()
        if signal.endswith(".command")
    }
    if not actions:
        raise SettingsError(f"dataset {reference}", "no command of a LeRobot dataset", "one that sysid start or a recipe made")
    delays = {actions[r["axis"]]: r["delay"] for r in responses if r["axis"] in actions and math.isfinite(r["delay"])}
    write_shifted(folder, target, delays)
    for axis in (axis for axis, field in actions.items() if field not in delays):
        out.line(f"{axis}: no delay is known; its action stays")
    out.line(f"made  {target}")
    out.json({"schema": 1, "made": target, "delays": delays})


@datasets.command()
@click.argument("reference", metavar="NAME[@VERSION]")
@json_option
@click.pass_obj
def lineage(location: str, reference: str, out: Printer) -> None:
    """Show the sources of a version, and the models made from it."""
    from sysid.cli.version_tables import show_lineage
    from sysid.datasets import lineage as lineage_of
    from sysid.workspace import open_workspace

    workspace = open_workspace(location)
    found = lineage_of(workspace.datasets, reference)
    models = workspace.made_from(found.dataset, found.digest)
    show_lineage(out, found, models)
    out.json({**found.to_json(), "models": [{"model": m.reference, "kind": m.kind} for m in models]})


@datasets.command()
@click.argument("references", metavar="[NAME[@VERSION]]…", nargs=-1)
@click.option("--keep", type=int, metavar="N", help="Remove all but the newest N versions of each dataset.")
@click.option("--dry-run", is_flag=True, help="Only list what would be removed.")
@click.option("--yes", is_flag=True, help="Remove it. Not needed if versions are named.")
@json_option
@click.pass_obj
def vacuum(location: str, references: tuple[str, ...], keep: int | None, dry_run: bool, yes: bool, out: Printer) -> None:
    """Remove left-overs of interrupted work, and versions, but none that a model was made from.

    NAME@VERSION is removed; NAME alone limits the command to that dataset. Without a named version and without --yes, what
    would be removed is only listed.
    """
    from sysid.cli.version_tables import show_vacuumed
    from sysid.workspace import open_workspace

    if dry_run and yes:
        raise SettingsError("sysid datasets vacuum", "--dry-run with --yes", "one of them")
    named = any("@" in reference for reference in references)
    if named and keep is not None and not (yes or dry_run):
        raise SettingsError("sysid datasets vacuum", "versions and --keep", "--yes as well", "Add --yes or --dry-run.")
    workspace = open_workspace(location)
    only_list = dry_run or not (named or yes)
    found = workspace.vacuum(references, keep=keep, dry_run=only_list)
    show_vacuumed(out, found, workspace.models.uri, hint=only_list and not dry_run)
    removed = [{"what": item.what, "size": item.size} for item in found.removed]
    kept = [{"what": item.what, "reason": item.reason} for item in found.kept]
    out.json({"schema": 1, "dry_run": found.dry_run, "size": found.size, "removed": removed, "kept": kept})
    refused = [item for item in found.kept if item.what in references]
    if refused:
        raise StoreError(refused[0].what, f"not removed: {refused[0].reason}", "a version without models made from it")


def _entry(entry: Any) -> dict[str, Any]:
    keys = ("machine", "recordings", "seconds", "created", "digest", "damage")
    return {"dataset": entry.reference, **{key: getattr(entry, key) for key in keys}}


def tables(store: Store, reference: str) -> list[dict[str, Any]]:
    """Locations of the Delta tables of a version, for other tools."""
    return [
        {"recordings": list(part.recordings), "samples": part.samples, "channels": part.channels}
        for part in store.tables(reference)
    ]


def describe(dataset: Dataset) -> dict[str, Any]:
    """A dataset version as JSON values."""
    from dataclasses import asdict

    return {
        "schema": 1,
        "dataset": dataset.reference,
        "digest": dataset.digest,
        "machine": dataset.machine.name,
        "recordings": [
            {
                "name": recording.name,
                "kind": recording.kind,
                "role": dataset.splits.get(recording.name),
                "rows": len(recording),
                "rate_hz": recording.rate_hz,
                "signals": list(recording.signals),
            }
            for recording in dataset.recordings
        ],
        "units": dict(dataset.units),
        "clocks": [asdict(clock) for clock in dataset.clocks],
        "sources": [asdict(source) for source in dataset.sources],
        "quality": dict(dataset.quality),
    }
