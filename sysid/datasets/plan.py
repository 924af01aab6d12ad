"""Inputs of an ingest (folders, recipe and machine) with their part of the digest, and what its recordings have in common:
which are kept, their units (also those that neither files nor recipe state), streams, notes and provenance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.datasets.channel import Channel
from sysid.datasets.channels import Mounts, ReadRecording
from sysid.datasets.chunked import Array
from sysid.datasets.discover import RecordingFiles, all_files, left_out, sha256, unmatched
from sysid.datasets.recipe import NO_RECIPE, IngestRecipe, Splits, StreamMap, check_against_machine, load_recipe
from sysid.datasets.recording import ClockRecord, Dataset, Recording, Role, Source
from sysid.datasets.resample import GAP_PERIODS
from sysid.datasets.versions.manifest import PartRecord
from sysid.errors import AlignmentError, InputError, SettingsError
from sysid.logs import reader_for
from sysid.logs.time_unit import NEAR, SECONDS
from sysid.machine import Axis, Machine, load_machine
from sysid.signals import axis_signal

#: Part of every digest; to be increased when the same logs give another table.
INGEST_VERSION = 6


@dataclass(frozen=True)
class Plan:
    """Folders, recipe and machine of an ingest; ``where`` is named in errors."""

    roots: tuple[Path, ...]
    rules: IngestRecipe
    machine: Machine
    where: Path

    @property
    def recipe_place(self) -> str:
        """Where the recipe is that the next ingest of the same paths takes, for a remedy."""
        if self.rules.text:
            return f"the recipe ({self.where})" if self.where.is_file() else "the recipe"
        first = "whose first line is `schema = 1`"
        alone = len(self.roots) == 1 and self.roots[0].is_dir()
        return f"a file {self.roots[0] / 'recipe.toml'}, {first}" if alone else f"a recipe, {first}, and name it with --recipe"


def plan_of(
    paths: Sequence[Path | str] | Path | str,
    machine: Path | str | None,
    recipe: Path | str | None,
    otherwise: Callable[[], IngestRecipe] = lambda: NO_RECIPE,
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
    rules = load_recipe(recipe_path) if recipe_path is not None else otherwise()
    machine_path = _machine_path(machine, rules, recipe_path, roots)
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
    machine: Path | str | None, rules: IngestRecipe, recipe_path: Path | None, roots: Sequence[Path]
) -> Path | None:
    if machine is not None:
        return Path(machine)
    if rules.machine is not None and recipe_path is not None:
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


def content_of(sources: Sequence[Source], rules: IngestRecipe) -> dict[str, Any]:
    """Inputs of the tables except the machine, as plain JSON values for the digest."""
    content: dict[str, Any] = {
        "ingest": INGEST_VERSION,
        "sources": sorted((source.path, source.sha256) for source in sources),
        "recipe": rules.text,
    }
    databases = {stream.dbc for stream in rules.streams if stream.dbc is not None}
    if databases:
        content["databases"] = sorted(sha256(Path(database)) for database in databases)
    return content


def settings_of(plan: Plan) -> dict[str, Any]:
    """Settings of resampling, for the lineage."""
    rules = plan.rules
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


def placed(names: Sequence[str], refused: Mapping[str, AlignmentError], splits: Splits) -> tuple[str, ...]:
    """The recordings that could be placed in time.

    Args:
        refused: recording → the error.

    Raises:
        AlignmentError: none could, or not one that the recipe names in its splits.
    """
    named = {*splits.fit, *splits.select, *splits.held_out, *splits.held_out_last}
    kept = tuple(name for name in names if name not in refused)
    for name, error in refused.items():
        if not kept or name in named:
            raise error
    return kept


def streams_of(pairs: Sequence[tuple[str, str]], tables: Sequence[Recording]) -> dict[str, tuple[str, ...]]:
    """File stem → its signals in the tables.

    Args:
        pairs: :func:`~sysid.datasets.tasks.steps.stream_signals` of all recordings.
    """
    kept = {signal for table in tables for signal in table.signals}
    found: dict[str, dict[str, None]] = {}
    for stream, signal in pairs:
        if signal in kept:
            found.setdefault(stream, {})[signal] = None
    return {stream: tuple(signals) for stream, signals in sorted(found.items())}


def ingested_dataset(
    plan: Plan,
    parts: Sequence[Recording],
    roles: Mapping[str, Role],
    clocks: tuple[ClockRecord, ...],
    channels: Mapping[str, Sequence[Channel]],
    streams: Sequence[tuple[str, str]],
    sources: Sequence[Source],
    losses: Mapping[str, tuple[str, ...]],
) -> tuple[Dataset, tuple[str, ...]]:
    """The dataset of an ingest without its name, digest and quality, and notes on units that nothing states.

    Args:
        channels: recording → its channels, for their units.
        streams: :func:`~sysid.datasets.tasks.steps.stream_signals` of all recordings.
        losses: ``recording/file`` → what was lost when it was read.
    """
    units, assumed = with_joint_units(units_of(channels), plan.machine)
    dataset = Dataset(
        name=plan.machine.name,
        version=0,
        digest="",
        machine=plan.machine,
        recordings=tuple(parts),
        units=units,
        splits=roles,
        sources=tuple(replace(source, losses=losses.get(source.path, ())) for source in sources),
        clocks=clocks,
        streams=streams_of(streams, parts),
    )
    return dataset, assumed


def units_of(channels: Mapping[str, Sequence[Channel]]) -> dict[str, str]:
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


def notes_of(
    found: Sequence[RecordingFiles],
    plan: Plan,
    mounts: Mounts,
    rates: Sequence[str],
    commands: Iterable[Mapping[str, float]],
    refused: Mapping[str, AlignmentError],
) -> tuple[str, ...]:
    """Notes on an ingest.

    Args:
        rates: :func:`rate_notes` of all recordings.
        commands: :func:`command_rates` of each.
        refused: recordings that could not be placed in time.
    """
    omitted = [f"left out: {error}" for error in refused.values()]
    if stated := sorted({key for keys in left_out(plan.roots, plan.rules).values() for key in keys}):
        omitted.append(f"{len(stated)} file{'s' if len(stated) > 1 else ''} left out by the recipe: {', '.join(stated)}")
    rates = rates or command_notes(commands, plan.machine.rate_hz)  # the rate of a wrong unit says nothing
    return (*offset_notes(plan.rules.streams, mounts, plan.machine), *unmatched(found, plan.rules), *rates, *omitted)


def made_by(found: Sequence[RecordingFiles], plan: Plan, mounts: Mounts) -> PartRecord:
    """Provenance of the tables of an ingest."""
    return PartRecord(INGEST_VERSION, plan.rules.text, settings_of(plan), shared_mounts(found, mounts))


#: Least cosine of the angle between an offset and the last link for which they count as parallel.
ALONG = 0.9


def offset_notes(
    streams: Sequence[StreamMap], mounts: Mapping[tuple[str, str], Mapping[str, Array]], machine: Machine
) -> list[str]:
    """A note for every ``ee`` whose surveyed offset is along the last link: its error and a link length error are equivalent.

    Args:
        mounts: (recording, key of the entry) → body → its pose on its link.
    """
    kinematics = machine.kinematics()
    notes: list[str] = []
    for mapping in streams:
        point = mapping.points.get("ee")
        if kinematics is None or point is None or point.body not in mapping.bodies or mapping.reference is None:
            continue
        mount = next(
            (own[point.body] for (_, files), own in mounts.items() if files == mapping.key and point.body in own), None
        )
        if mount is None or not any(point.at):
            continue
        poses = kinematics.link_poses(np.array([[mapping.reference.joints[name] for name in machine.axis_names]]))
        revolute = [joint for joint in kinematics.chain if joint.kind in ("revolute", "continuous")]
        if not revolute:
            continue
        joint = revolute[-1]
        link = poses[kinematics.tip][0, :3, 3] - poses[joint.child][0, :3, 3]
        at = (poses[mapping.bodies[point.body]][0] @ mount)[:3, :3] @ np.array(point.at)
        length = float(np.linalg.norm(link))
        along = float(at @ link) / length if length > 0.0 else 0.0
        if length > 0.0 and abs(along) > ALONG * float(np.linalg.norm(at)):
            axis = machine.axis_names[kinematics.drives[joint.name].column]
            notes.append(
                f"ee: the offset of {point.body!r} reaches {1e3 * along:+.1f} mm along the last link. Its error and an error "
                f"of the length of that link (link_length_error of {axis}) are not distinguishable in these data: survey the "
                "offset as accurately as the length has to be known"
            )
    return notes


#: Units of signals of a prismatic and of a revolute joint.
_PRISMATIC, _REVOLUTE = frozenset({"m", "m/s", "N"}), frozenset({"rad", "rad/s", "N·m"})


def with_joint_units(units: Mapping[str, str], machine: Machine) -> tuple[dict[str, str], tuple[str, ...]]:
    """Units with those of the joints filled in, and a note on axes that nothing describes.

    An axis has one kind of joint: the unit of one of its signals determines the others. An axis without any is revolute.

    Args:
        units: signal → SI unit; ``1`` for a signal that has none.
    """
    found, assumed = dict(units), []
    for axis in machine.axes:
        open_ = [signal for signal in _of_joint(axis) if found.get(signal) == "1" and machine.expected_unit(signal) is None]
        if not open_:
            continue
        stated = {found[signal] for signal in _of_joint(axis) if signal in found}
        joint = "m" if stated & _PRISMATIC else "rad"
        found |= {signal: _unit(axis, signal, joint) for signal in open_}
        if not stated & (_PRISMATIC | _REVOLUTE):
            assumed.append(axis.name)
    if not assumed:
        return found, ()
    one = len(assumed) == 1
    return found, (
        f"{', '.join(assumed)}: neither logs nor machine.toml state a unit, so the joint{'' if one else 's'} "
        f'{"is" if one else "are"} taken as revolute [rad]. A prismatic axis needs joint_type = "prismatic" in machine.toml.',
    )


def _of_joint(axis: Axis) -> tuple[str, ...]:
    """The signals of an axis whose unit depends on the kind of its joint."""
    if axis.drives == "cylinder":
        return (axis_signal(axis.name, "joint"),)
    names = ("joint", "speed") if axis.actuation == "velocity" else ("joint", "speed", "command")
    return tuple(axis_signal(axis.name, name) for name in names)


def _unit(axis: Axis, signal: str, joint: str) -> str:
    if signal.endswith(".speed"):
        return f"{joint}/s"
    if signal.endswith(".command") and axis.actuation == "force":
        return "N" if joint == "m" else "N·m"
    return joint


#: Rate of commands over that of the grid from which a note says so: about twice.
FASTER = 1.9


def rate_notes(found: Sequence[RecordingFiles], readings: Mapping[str, ReadRecording], rate_hz: float) -> tuple[str, ...]:
    """A note for each table without ``time_unit``, read in seconds, whose rate fits the machine's in another unit only."""
    notes = []
    for files in found:
        rates: dict[str, float] = {}
        for channel in readings[files.name].channels:
            if channel.period_s > 0.0:
                rates.setdefault(channel.source, 1.0 / channel.period_s)
        for path, mapping in files.streams:
            stated = mapping is not None and (mapping.time_unit is not None or mapping.rate_hz is not None)
            rate = rates.get(path.name)
            if stated or rate is None or 1.0 / (2.0 * NEAR) <= rate / rate_hz <= 2.0 * NEAR:
                continue
            if (mapping is not None and mapping.reader not in (None, "csv")) or reader_for(path).clocks != ("time",):
                continue
            likely = [unit for unit, factor in SECONDS.items() if 1.0 / NEAR <= rate / factor / rate_hz <= NEAR]
            notes += [
                f"{files.name}/{path.name}: {rate:.4g} samples a second, machine.toml states {rate_hz:g} Hz. Are the stamps in "
                f"{unit}? Then state `time_unit` in the recipe"
                for unit in likely[:1]
            ]
    return tuple(notes)


def command_rates(reading: ReadRecording) -> dict[str, float]:
    """Log file → rate of its commands [Hz], of a recording."""
    commands = (c for c in reading.channels if c.signal.endswith(".command"))
    return {c.source: 1.0 / c.period_s for c in commands if c.period_s > 0.0}


def command_notes(recordings: Iterable[Mapping[str, float]], rate_hz: float) -> tuple[str, ...]:
    """A note for each log file whose commands come faster than the grid has rows: those between two rows act later.

    Args:
        recordings: :func:`command_rates` of each; ``rate_hz``: of the machine.
    """
    rates: dict[str, list[float]] = {}
    for own in recordings:
        for source, rate in own.items():
            if rate > FASTER * rate_hz:
                rates.setdefault(source, []).append(rate)
    return tuple(
        f"{source}: commands at {max(found):.4g} Hz{f' in {len(found)} recordings' if len(found) > 1 else ''}, the grid has "
        f"{rate_hz:g} Hz: a command between two rows acts up to {1e3 / rate_hz:.3g} ms later. "
        f"State rate_hz = {max(found):.4g} in machine.toml"
        for source, found in rates.items()
    )
