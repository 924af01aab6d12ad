"""Logs → dataset version, in one walk: discover → read → align clocks → resample → split → describe → store."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from sysid.datasets.channel import Channel
from sysid.datasets.channels import Reading, concatenate, joined, read_channels, survey_mounts
from sysid.datasets.clocks import Clocked, align, by_source, machine_times
from sysid.datasets.discover import RecordingFiles, discover, sha256
from sysid.datasets.poses import pose_table, still_phases
from sysid.datasets.quality import describe
from sysid.datasets.recipe import Recipe, check_against_machine, load_recipe
from sysid.datasets.recording import ClockRecord, Dataset, Recording, Source
from sysid.datasets.resample import grid, resample
from sysid.datasets.splits import split
from sysid.datasets.store import Store
from sysid.errors import InputError, SettingsError
from sysid.machine import Machine, load_machine
from sysid.progress import Progress, silent

#: Part of every digest: raise it when the same logs would give another table.
INGEST_VERSION = 1


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
        progress: called with the share done and a text.

    Raises:
        InputError: a log that cannot be used as it is.
        SettingsError: a mistake in ``machine.toml`` or in the recipe.
    """
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with threadpool_limits(limits=1):  # thousands of small systems: threads cost ten times what they save
        return _ingest(paths, workspace, machine, recipe, name, progress or silent)


def _ingest(
    paths: Sequence[Path | str] | Path | str,
    workspace: Path | str,
    machine: Path | str | None,
    recipe: Path | str | None,
    name: str | None,
    report: Progress,
) -> Dataset:
    roots = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    for root in roots:
        if not root.exists():
            raise InputError(root, "no such file or folder", "a folder of recordings or a log file", "Check the path.")
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

    report(0.0, "reading file names")
    found = discover(roots, rules)
    sources = _sources(found)
    digest = _digest(sources, rules, description)
    store = Store(workspace)
    known = store.find_digest(title, digest)
    if known is not None:
        report(1.0, f"the same logs are {title}@{known}")
        return store.load(f"{title}@{known}")

    settings = rules if rules is not None else Recipe(schema=1)
    mounts = survey_mounts(found, description)
    readings: dict[str, Reading] = {}
    for number, files in enumerate(found):
        report(0.05 + 0.35 * number / len(found), f"reading {files.name}")
        readings[files.name] = read_channels(files, description, mounts)
    channels = {name: reading.channels for name, reading in readings.items()}
    losses = {f"{name}/{file}": items for name, reading in readings.items() for file, items in reading.losses.items()}
    clocked = [Clocked(files.name, files.kind, channels[files.name]) for files in found]
    report(0.4, "aligning clocks")
    clocks = align(clocked)
    recordings = []
    for number, recording in enumerate(clocked):
        report(0.8 + 0.1 * number / len(found), f"resampling {recording.name}")
        recordings.append(_recording(recording, by_source(clocks, recording.name), description, settings))
    parts, roles = split(recordings, settings.splits, where)
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
        quality=describe(parts, readings, clocks, description),
        streams=_streams(clocked, parts),
    )
    report(0.95, "storing")
    saved = store.save(dataset, channels, rules.text if rules is not None else "")
    report(1.0, f"stored {saved.reference}")
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
    databases = {stream.dbc for stream in rules.streams if stream.dbc is not None} if rules is not None else set()
    if databases:
        content["databases"] = sorted(sha256(Path(database)) for database in databases)
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode("utf-8")).hexdigest()


def _recording(recording: Clocked, records: Mapping[str, ClockRecord], machine: Machine, rules: Recipe) -> Recording:
    """The aligned table of one recording."""
    start = recording.start_ns
    where = f"recording {recording.name}"
    signals = {name: concatenate(parts) for name, parts in joined(recording.channels, where).items()}
    signals = {name: signals[name] for name in machine.signals if name in signals}
    times = {name: machine_times(channel, start, records.get(channel.source)) for name, channel in signals.items()}
    if recording.kind == "poses":
        sensors = [c for c in recording.machine if not c.signal.endswith(".command")]
        measured = {c.signal: (machine_times(c, start, None), c.values) for c in sensors}  # noqa: PD011
        phases = still_phases(measured, rules.still, where)
        slack = {name: _slack(records[c.source]) for name, c in signals.items() if c.source in records}
        values = {n: (times[n], c.values) for n, c in signals.items() if not n.endswith(".command")}  # noqa: PD011
        return Recording(
            recording.name,
            pose_table(phases, values, slack, machine.noise, rules.still.tolerance),
            machine.rate_hz,
            "poses",
            start,
        )
    end = max(int(channel.stamps[-1]) for channel in recording.machine)
    at = grid(start, end, machine.rate_hz)
    columns = {"time": at}
    for name, channel in signals.items():
        columns[name] = resample(channel, times[name], at, machine.rate_hz, rules.hold_s)
    return Recording(recording.name, pd.DataFrame(columns), machine.rate_hz, "motion", start)


def _streams(recordings: Sequence[Clocked], tables: Sequence[Recording]) -> dict[str, tuple[str, ...]]:
    """File stem → the signals in the tables that came from it."""
    kept = {signal for table in tables for signal in table.signals}
    found: dict[str, dict[str, None]] = {}
    for recording in recordings:
        for name, parts in joined(recording.channels, f"recording {recording.name}").items():
            if name in kept:
                found.setdefault(Path(parts[0].source).stem, {})[name] = None
    return {stream: tuple(signals) for stream, signals in sorted(found.items())}


def _slack(record: ClockRecord) -> float:
    """By how much the window of a still phase is widened for a clock that is known to a part of a hold only [s]."""
    half = (record.offset_interval95[1] - record.offset_interval95[0]) / 2.0
    return half if half > 0.01 else 0.0


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
