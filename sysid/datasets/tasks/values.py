"""Values between caller and tasks as plain ones: numbers, text, lists and dictionaries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from sysid.datasets.channel import Channel, RowCounts
from sysid.datasets.channels import Mounts, ReadRecording
from sysid.datasets.clocks.estimate import Backlash, Estimate
from sysid.datasets.clocks.resets import Piece
from sysid.datasets.flags.flag import Flag
from sysid.datasets.frames.mistakes import MissingFrames
from sysid.errors import AlignmentError, InputError, SysidError

Plain = dict[str, Any]

_ARRAYS = ("stamps", "values")


def from_channel(channel: Channel) -> Plain:
    """A channel without its samples, whose number is ``samples``."""
    own = {field.name: getattr(channel, field.name) for field in fields(channel) if field.name not in _ARRAYS}
    flags = [asdict(flag) for flag in channel.flags]
    return {**own, "counts": asdict(channel.counts), "flags": flags, "samples": len(channel.stamps)}


def to_channel(entry: Plain, stamps: Any = None, values: Any = None) -> Channel:
    """The channel with these samples, by default without any."""
    own = {key: value for key, value in entry.items() if key != "samples"}
    own["counts"] = RowCounts(**entry["counts"])
    own["flags"] = tuple(Flag(**flag) for flag in entry["flags"])
    nothing = stamps is None
    return Channel(**own, stamps=np.empty(0, np.int64) if nothing else stamps, values=np.empty(0) if nothing else values)


def from_reading(reading: ReadRecording) -> Plain:
    """A recording that was read, without the samples of its channels."""
    return {
        "channels": [from_channel(channel) for channel in reading.channels],
        "losses": {file: list(texts) for file, texts in reading.losses.items()},
        "missing_frames": [asdict(flag) for flag in reading.flags],
        "refused": from_refused(reading.refused),
    }


def to_reading(entry: Plain, samples: Sequence[tuple[Any, Any]] | None = None) -> ReadRecording:
    """The recording with ``samples`` (stamps, values) of its channels, by default without any."""
    arrays = samples if samples is not None else [(None, None)] * len(entry["channels"])
    channels = tuple(to_channel(own, *pair) for own, pair in zip(entry["channels"], arrays, strict=True))
    losses = {file: tuple(texts) for file, texts in entry["losses"].items()}
    flags = tuple(MissingFrames(**flag) for flag in entry["missing_frames"])
    return ReadRecording(channels, losses, flags, to_refused(entry["refused"]))


def from_pieces(found: Mapping[str, Sequence[Piece]]) -> Plain:
    """Clock → pieces, without the residuals of their fits in blocks."""
    return {clock: [_from_piece(piece) for piece in pieces] for clock, pieces in found.items()}


def _from_piece(piece: Piece) -> Plain:
    estimate = asdict(replace(piece.estimate, blocks=None))
    matrices = {name: estimate[name].tolist() for name in ("covariance", "normal")}
    return {"first_s": piece.first_s, "last_s": piece.last_s, "estimate": {**estimate, **matrices}}


def to_pieces(entry: Plain) -> dict[str, tuple[Piece, ...]]:
    return {clock: tuple(_to_piece(own) for own in pieces) for clock, pieces in entry.items()}


def _to_piece(entry: Plain) -> Piece:
    estimate = {
        **entry["estimate"],
        **{name: np.array(entry["estimate"][name]) for name in ("covariance", "normal")},
        "backlash": tuple(Backlash(**own) for own in entry["estimate"]["backlash"]),
    }
    return Piece(entry["first_s"], entry["last_s"], Estimate(**estimate))


def from_mounts(mounts: Mounts, recording: str) -> Plain:
    """Mounts of the bodies in one recording: key of the recipe's entry → body → 4×4."""
    return {
        key: {body: pose.tolist() for body, pose in bodies.items()}
        for (name, key), bodies in mounts.items()
        if name == recording
    }


def to_mounts(entry: Plain, recording: str) -> Mounts:
    return {(recording, key): {body: np.array(pose) for body, pose in bodies.items()} for key, bodies in entry.items()}


def from_refused(refused: Mapping[str, InputError]) -> Plain:
    """``recording/file`` → the parts of the error for which it cannot be used."""
    return {key: from_error(error) for key, error in refused.items()}


def to_refused(entry: Plain) -> dict[str, InputError]:
    return {key: InputError(*own) for key, own in entry.items()}


def from_error(error: SysidError) -> list[str]:
    return [str(part) for part in (error.where, error.found, error.expected, error.remedy)]


def to_error(entry: Sequence[str]) -> AlignmentError:
    return AlignmentError(*entry)
