"""The capture system's log as OptiTrack Motive exports it: CSV, format version 1.23, quaternions, metres, global space.

Source: the layout of real exports (header rows Type, Name, ID, channel, axis; empty cells where nothing was seen).
"""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from simulated_bench.capture import BodyTrack, Capture
from simulated_bench.capture_recipe import marker_label

#: Channel and axis of the columns of a rigid body.
_BODY = (
    *(("Rotation", axis) for axis in "XYZW"),
    *(("Position", axis) for axis in "XYZ"),
    ("Mean Marker Error", ""),
)
_MARKER = tuple(("Position", axis) for axis in "XYZ")


def write_motive(
    take: Capture, path: Path, name: str, started: datetime, capture_rate: float, exported_markers: tuple[str, ...] = ()
) -> None:
    """Write ``take`` as Motive does.

    Args:
        name: the take's name.
        started: wall clock of the capture computer at the take's first frame (informative, not synchronised).
        exported_markers: bodies whose markers are exported as well.
    """
    columns: list[tuple[str, str, str, str, str]] = []
    values = []
    for body in take.bodies:
        identity = _identity(body.name)
        columns += [("Rigid Body", body.name, identity, channel, axis) for channel, axis in _BODY]
        values.append(np.column_stack([body.quaternion, body.position, body.marker_error]))
    for body in take.bodies:
        if body.name in exported_markers:
            columns += _marker_columns(body)
            values.append(body.markers.reshape(len(take.time), -1))
    table = np.hstack(values)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(_first_line(take, name, started, capture_rate) + "\r\n\r\n")
        for head, part in ((",Type,", 0), (",Name,", 1), (",ID,", 2), (",,", 3), ("Frame,Time (Seconds),", 4)):
            file.write(head + ",".join(column[part] for column in columns) + "\r\n")
        for frame, time, row in zip(take.frames, take.time, table, strict=True):
            cells = ",".join("" if np.isnan(value) else f"{value:.6f}" for value in row)
            file.write(f"{frame},{time:.6f},{cells}\r\n")


def _first_line(take: Capture, name: str, started: datetime, capture_rate: float) -> str:
    total = int(take.frames[-1]) + 1
    fields = {
        "Format Version": "1.23",
        "Take Name": name,
        "Take Notes": "",
        "Capture Frame Rate": f"{capture_rate:.6f}",
        "Export Frame Rate": f"{take.rate:.6f}",
        "Capture Start Time": _clock(started),
        "Total Frames in Take": str(round((total - 1) * capture_rate / take.rate) + 1),
        "Total Exported Frames": str(len(take.frames)),
        "Rotation Type": "Quaternion",
        "Length Units": "Meters",
        "Coordinate Space": "Global",
    }
    return ",".join(f"{key},{value}" for key, value in fields.items())


def wall_clock(start_ns: int, ahead: float) -> datetime:
    """Wall clock of a computer ``ahead`` seconds of the machine's clock at ``start_ns``."""
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=start_ns // 1000) + timedelta(seconds=ahead)


def _clock(moment: datetime) -> str:
    return f"{moment:%Y-%m-%d %I.%M.%S}.{moment.microsecond // 1000:03d} {'AM' if moment.hour < 12 else 'PM'}"


def _identity(text: str) -> str:
    digest = hashlib.sha256(text.encode()).hexdigest()[:32].upper()
    return f'"{digest}"'


def _marker_columns(body: BodyTrack) -> list[tuple[str, str, str, str, str]]:
    columns = []
    for index in range(body.markers.shape[1]):
        name = marker_label(body.name, index)
        columns += [("Marker", name, _identity(name), channel, axis) for channel, axis in _MARKER]
    return columns
