"""Logs → dataset version, in one walk: discover → read → align clocks → resample → split → describe → store."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from sysid.datasets.channel import Channel
from sysid.datasets.channels import concatenate, joined, read_channels
from sysid.datasets.discover import RecordingFiles, discover, sha256
from sysid.datasets.quality import describe
from sysid.datasets.recipe import Recipe, check_against_machine, load_recipe
from sysid.datasets.recording import ClockRecord, Dataset, Recording, Source
from sysid.datasets.resample import grid, resample
from sysid.datasets.splits import split
from sysid.datasets.store import Store
from sysid.errors import InputError, SettingsError
from sysid.machine import Machine, load_machine

#: Part of every digest: raise it when the same logs would give another table.
INGEST_VERSION = 1

Progress = Callable[[str, float], None]


def ingest(
    paths: Sequence[Path | str] | Path | str,
    workspace: Path | str,
    machine: Path | str | None = None,
    recipe: Path | str | None = None,
    name: str | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Read logs and store them as a new version of dataset ``name``; the same content again returns the version there is.

    Args:
        paths: folders of recordings (``DIR/<recording>/<files>``) or single log files.
        workspace: folder or object-store URL.
        machine: ``machine.toml``; else what the recipe names, else ``machine.toml`` beside the logs.
        recipe: ``recipe.toml``; else the one in the ingested folder, else the columns have canonical names.
        name: of the dataset; else the recipe's, else the machine's.
        progress: called with a text and the share done.

    Raises:
        InputError: a log that cannot be used as it is.
        SettingsError: a mistake in ``machine.toml`` or in the recipe.
    """
    report = progress if progress is not None else lambda _text, _share: None
    roots = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    recipe_path = _recipe_path(recipe, roots)
    rules = load_recipe(recipe_path) if recipe_path is not None else None
    description = load_machine(_machine_path(machine, rules, recipe_path, roots))
    where = recipe_path if recipe_path is not None else roots[0]
    if rules is not None:
        check_against_machine(rules, description, where)
        if rules.logs is not None and recipe_path is not None:
            same = [root.is_dir() and root.resolve() == recipe_path.parent.resolve() for root in roots]
            roots = [root / rules.logs if own else root for root, own in zip(roots, same, strict=True)]
    title = name or (rules.name if rules is not None else None) or description.name
    _check_name(title)

    report("reading file names", 0.0)
    found = discover(roots, rules)
    sources = _sources(found)
    digest = _digest(sources, rules, description)
    store = Store(workspace)
    known = store.find_digest(title, digest)
    if known is not None:
        report(f"the same logs are {title}@{known}", 1.0)
        return store.load(f"{title}@{known}")

    channels: dict[str, tuple[Channel, ...]] = {}
    losses: dict[str, tuple[str, ...]] = {}
    for number, files in enumerate(found):
        report(f"reading {files.name}", 0.05 + 0.45 * number / len(found))
        channels[files.name], lost = read_channels(files, description)
        losses |= {f"{files.name}/{file}": items for file, items in lost.items()}
    clocks: tuple[ClockRecord, ...] = ()
    recordings = []
    for number, files in enumerate(found):
        report(f"resampling {files.name}", 0.7 + 0.2 * number / len(found))
        recordings.append(_recording(files, channels[files.name], clocks, description, rules or Recipe(schema=1)))
    splits = (rules or Recipe(schema=1)).splits
    parts, roles = split(recordings, splits, where)
    units = _units(channels)
    parts = tuple(_with_units(part, units) for part in parts)
    dataset = Dataset(
        name=title,
        version=0,
        digest=digest,
        machine=description,
        recordings=parts,
        units=units,
        splits=roles,
        sources=tuple(replace(source, losses=losses.get(source.path, ())) for source in sources),
        clocks=clocks,
        quality=describe(parts, channels, description),
    )
    report("storing", 0.95)
    saved = store.save(dataset, channels, rules.text if rules is not None else "")
    report(f"stored {saved.reference}", 1.0)
    return saved


def _recipe_path(recipe: Path | str | None, roots: Sequence[Path]) -> Path | None:
    if recipe is not None:
        return Path(recipe)
    beside = [root / "recipe.toml" for root in roots if (root / "recipe.toml").is_file()]
    return beside[0] if len(beside) == 1 else None


def _machine_path(machine: Path | str | None, rules: Recipe | None, recipe_path: Path | None, roots: Sequence[Path]) -> Path:
    if machine is not None:
        return Path(machine)
    if rules is not None and rules.machine is not None and recipe_path is not None:
        return recipe_path.parent / rules.machine
    for root in roots:
        for folder in (root, root.parent):
            if (folder / "machine.toml").is_file():
                return folder / "machine.toml"
    raise SettingsError(
        roots[0], "no machine description", "machine.toml", "Give one with --machine, or name it in the recipe."
    )


def _check_name(name: str) -> None:
    if not name or not all(letter.isalnum() or letter in "-_." for letter in name) or name.startswith("."):
        raise SettingsError("dataset name", repr(name), "letters, digits, '-', '_' and '.'", "Choose another --name.")


def _sources(found: Sequence[RecordingFiles]) -> tuple[Source, ...]:
    unique: dict[str, Source] = {}
    for recording in found:
        for path, _ in recording.streams:
            key = f"{recording.name}/{path.name}"
            if key not in unique:
                unique[key] = Source(key, sha256(path), path.stat().st_size)
    return tuple(unique.values())


def _digest(sources: Sequence[Source], rules: Recipe | None, machine: Machine) -> str:
    content = {
        "ingest": INGEST_VERSION,
        "sources": sorted((source.path, source.sha256) for source in sources),
        "recipe": rules.text if rules is not None else "",
        "machine": machine.files(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode("utf-8")).hexdigest()


def _recording(
    files: RecordingFiles, channels: Sequence[Channel], clocks: Sequence[ClockRecord], machine: Machine, rules: Recipe
) -> Recording:
    """The aligned table of one recording."""
    own = [channel.stamps for channel in channels if channel.domain == "machine" and len(channel.stamps)]
    if not own:
        raise InputError(files.root, "no samples on the machine's clock", "commands or sensors of the machine")
    start, end = min(int(s[0]) for s in own), max(int(s[-1]) for s in own)
    at = grid(start, end, machine.rate_hz)
    columns = {"time": at}
    signals = joined(channels, f"recording {files.name}")
    for signal in (name for name in machine.signals if name in signals):
        channel = concatenate(signals[signal])
        times = ((channel.stamps - start) * 1e-9).astype(np.float64)
        columns[signal] = resample(channel, times, at, machine.rate_hz, rules.hold_s)
    return Recording(files.name, pd.DataFrame(columns), machine.rate_hz, files.kind, start)


def _units(channels: Mapping[str, Sequence[Channel]]) -> dict[str, str]:
    """Signal → SI unit.

    Raises:
        InputError: a signal whose unit differs between recordings.
    """
    units = {"time": "s"}
    for name, parts in channels.items():
        for channel in parts:
            if units.setdefault(channel.signal, channel.unit) != channel.unit:
                found, expected = f"[{channel.unit}]", f"[{units[channel.signal]}] as in the recordings before"
                raise InputError(f"recording {name}: {channel.signal}", found, expected)
    return units


def _with_units(recording: Recording, units: Mapping[str, str]) -> Recording:
    recording.table.attrs["units"] = {str(column): units[str(column)] for column in recording.table.columns}
    return recording
