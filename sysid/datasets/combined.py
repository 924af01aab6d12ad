"""What the recordings of one ingest have in common: which are kept, their units, streams, notes and provenance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from sysid.datasets.channel import Channel
from sysid.datasets.channels import Mounts
from sysid.datasets.discover import RecordingFiles, left_out, unmatched
from sysid.datasets.frames.degenerate import offset_notes
from sysid.datasets.plan import INGEST_VERSION, Plan, settings_of, shared_mounts
from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Recording
from sysid.datasets.versions.manifest import PartRecord
from sysid.errors import AlignmentError, InputError


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
        pairs: :func:`~sysid.datasets.aligned.stream_signals` of all recordings.
    """
    kept = {signal for table in tables for signal in table.signals}
    found: dict[str, dict[str, None]] = {}
    for stream, signal in pairs:
        if signal in kept:
            found.setdefault(stream, {})[signal] = None
    return {stream: tuple(signals) for stream, signals in sorted(found.items())}


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
    rates: Iterable[str],
    refused: Mapping[str, AlignmentError],
) -> tuple[str, ...]:
    """Notes on an ingest.

    Args:
        rates: :func:`sysid.datasets.rates.rate_notes` of all recordings.
        refused: recordings that could not be placed in time.
    """
    streams = plan.rules.streams if plan.rules is not None else ()
    omitted = [f"left out: {error}" for error in refused.values()]
    if stated := sorted({key for keys in left_out(plan.roots, plan.rules).values() for key in keys}):
        omitted.append(f"{len(stated)} file{'s' if len(stated) > 1 else ''} left out by the recipe: {', '.join(stated)}")
    return (*offset_notes(streams, mounts, plan.machine), *unmatched(found, plan.rules), *rates, *omitted)


def made_by(found: Sequence[RecordingFiles], plan: Plan, mounts: Mounts) -> PartRecord:
    """Provenance of the tables of an ingest."""
    recipe = plan.rules.text if plan.rules is not None else ""
    return PartRecord(INGEST_VERSION, recipe, settings_of(plan), shared_mounts(found, mounts))
