"""Inputs of an ingest: folders, recipe and machine, and their part of the digest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.datasets.channels import Mounts
from sysid.datasets.discover import RecordingFiles, all_files, sha256
from sysid.datasets.recipe import IngestRecipe, check_against_machine, load_recipe
from sysid.datasets.recording import Source
from sysid.datasets.resample import GAP_PERIODS
from sysid.errors import InputError, SettingsError
from sysid.machine import Machine, load_machine

#: Part of every digest; to be increased when the same logs give another table.
INGEST_VERSION = 6


@dataclass(frozen=True)
class Plan:
    """Folders, recipe and machine of an ingest; ``where`` is named in errors."""

    roots: tuple[Path, ...]
    rules: IngestRecipe | None
    machine: Machine
    where: Path

    @property
    def recipe_place(self) -> str:
        """Where the recipe is that the next ingest of the same paths takes, for a remedy."""
        if self.rules is not None:
            return f"the recipe ({self.where})" if self.where.is_file() else "the recipe"
        first = "whose first line is `schema = 1`"
        alone = len(self.roots) == 1 and self.roots[0].is_dir()
        return f"a file {self.roots[0] / 'recipe.toml'}, {first}" if alone else f"a recipe, {first}, and name it with --recipe"


def plan_of(
    paths: Sequence[Path | str] | Path | str,
    machine: Path | str | None,
    recipe: Path | str | None,
    otherwise: Callable[[], IngestRecipe | None] = lambda: None,
    same: Machine | None = None,
) -> Plan:
    """Find recipe and machine for ``paths``.

    Args:
        otherwise: returns the recipe where none is named and none is beside the logs.
        same: the machine where none is named and none is beside the logs.

    Raises:
        InputError: a path that does not exist.
        SettingsError: no machine, or a mistake in it or in the recipe.
    """
    roots = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    for root in roots:
        if not root.exists():
            raise InputError(root, "no such file or folder", "a folder of recordings or a log file", "Check the path.")
    recipe_path = _recipe_path(recipe, roots)
    own = load_recipe(recipe_path) if recipe_path is not None else None
    rules = own if own is not None else otherwise()
    machine_path = _machine_path(machine, own, recipe_path, roots)
    if machine_path is not None:
        description = load_machine(machine_path)
        if description.effects:
            # The catalogue takes a third of a second to import.
            from sysid.effects.described import check_described

            check_described(description)
    elif same is not None:
        description = same
    else:
        remedy = "Give one with --machine, or name it in the recipe."
        raise SettingsError(roots[0], "no machine description", "machine.toml", remedy)
    where = recipe_path if recipe_path is not None else roots[0]
    if rules is not None:
        check_against_machine(rules, description, where)
        if rules.logs is not None and recipe_path is not None:
            own_folder = [root.is_dir() and root.resolve() == recipe_path.parent.resolve() for root in roots]
            roots = [root / rules.logs if here else root for root, here in zip(roots, own_folder, strict=True)]
    return Plan(tuple(roots), rules, description, where)


def _recipe_path(recipe: Path | str | None, roots: Sequence[Path]) -> Path | None:
    if recipe is not None:
        return Path(recipe)
    beside = [root / "recipe.toml" for root in roots if (root / "recipe.toml").is_file()]
    return beside[0] if len(beside) == 1 else None


def _machine_path(
    machine: Path | str | None, rules: IngestRecipe | None, recipe_path: Path | None, roots: Sequence[Path]
) -> Path | None:
    if machine is not None:
        return Path(machine)
    if rules is not None and rules.machine is not None and recipe_path is not None:
        return recipe_path.parent / rules.machine
    for root in roots:
        for folder in (root, root.parent):
            if (folder / "machine.toml").is_file():
                return folder / "machine.toml"
    return None


def sources_of(found: Sequence[RecordingFiles]) -> tuple[Source, ...]:
    unique: dict[str, Source] = {}
    known: dict[Path, str] = {}  # of a file with several recordings once
    for recording in found:
        for path in all_files(recording):
            key = f"{recording.name}/{path.name}"
            if key not in unique:
                if path not in known:
                    known[path] = sha256(path)
                unique[key] = Source(key, known[path], path.stat().st_size)
    return tuple(unique.values())


def content_of(sources: Sequence[Source], rules: IngestRecipe | None) -> dict[str, Any]:
    """Inputs of the tables except the machine, as plain JSON values for the digest."""
    content: dict[str, Any] = {
        "ingest": INGEST_VERSION,
        "sources": sorted((source.path, source.sha256) for source in sources),
        "recipe": rules.text if rules is not None else "",
    }
    databases = {stream.dbc for stream in rules.streams if stream.dbc is not None} if rules is not None else set()
    if databases:
        content["databases"] = sorted(sha256(Path(database)) for database in databases)
    return content


def settings_of(plan: Plan) -> dict[str, Any]:
    """Settings of resampling, for the lineage."""
    rules = plan.rules if plan.rules is not None else IngestRecipe(schema=1)
    streams = {
        stream.key: {"domain": stream.domain, "interpolation": stream.interpolation, "max_gap_s": stream.max_gap_s}
        for stream in rules.streams
    }
    still = {"still_seconds": rules.still.seconds, "still_tolerance": rules.still.tolerance} if rules.recordings.poses else {}
    return {"rate_hz": plan.machine.rate_hz, "hold_s": rules.hold_s, "gap_periods": GAP_PERIODS, **still, "streams": streams}


def shared_mounts(found: Sequence[RecordingFiles], mounts: Mounts) -> dict[str, dict[str, Any]]:
    """Entry of the recipe → body → mount, where one reference pose holds for all recordings."""
    shared: dict[str, dict[str, Any]] = {}
    for files in found:
        for _, stream in files.streams:
            if stream is not None and stream.bodies and stream.reference is not None and stream.reference.recording is not None:
                shared[stream.key] = {body: pose.tolist() for body, pose in mounts[files.name, stream.key].items()}
    return shared
