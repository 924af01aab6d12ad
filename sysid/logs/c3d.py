"""C3D trials of any motion capture system: every point is a stream ``x y z`` [m], all analog channels are one (``analog``).

Labels of markers are the names of the streams (``tip_body:Marker1``). A point that is not visible is missing, and so is one
exactly in the origin, which some programs write for points that are not visible. Events are not read.

A file is cut into blocks of 512 bytes: the header, the parameters in groups, and the frames. A frame holds every point (x, y, z
and a word for residual and cameras) and then a few samples of every analog channel, as 16-bit integers or as floats, in the
byte order and float format of the computer that wrote it.

Every size that the file states is checked against the size of the file. ezc3d reads the same values in the tests.
Source: Motion Lab Systems, "The C3D File Format User Guide"; c3d.org.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.capture import length_factor, without_lost
from sysid.logs.limits import Budget
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.table import to_ns

Array = npt.NDArray[np.float64]

BLOCK = 512
#: Processor byte of the parameter section → byte order.
_INTEL, _DEC, _MIPS = 84, 85, 86
#: Type byte of a parameter → NumPy kind without byte order.
_TYPES = {-1: "S1", 1: "i1", 2: "i2", 4: "f4"}


@dataclass(frozen=True)
class C3dFile:
    """Content of a file.

    Args:
        rate: frames per second [Hz]; ``first`` is the number of the first one, counted from 0.
        points: (n, p, 3) in the file's units, NaN where a point is not visible.
        analog: (n·k, c) scaled to the file's units, k samples a frame.
        parameters: ``GROUP:NAME`` → numbers, or tuple of texts.
        stated: number of frames in the header; ``points`` has fewer where the file is cut off.
        notes: parameters that contradict the header, and which value counts.
    """

    rate: float
    first: int
    points: Array
    analog: Array
    parameters: Mapping[str, Any]
    stated: int
    notes: tuple[str, ...] = ()

    def texts(self, name: str) -> tuple[str, ...]:
        """A text parameter with its continuations; empty where there is none."""
        return tuple(text for part in _continued(self.parameters, name, tuple) for text in part)


@dataclass(frozen=True)
class _Coding:
    """Byte order and float format."""

    order: str
    dec: bool

    def integers(self, data: bytes, kind: str = "i2") -> npt.NDArray[Any]:
        return np.frombuffer(data, self.order + kind)

    def floats(self, data: bytes) -> npt.NDArray[np.float32]:
        if not self.dec:
            return np.frombuffer(data, self.order + "f4")
        # A VAX float is an IEEE one with its halves exchanged and an exponent that is larger by two.
        halves = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
        return np.asarray(np.ascontiguousarray(halves).view("<f4").ravel() / 4.0, dtype=np.float32)


def read_c3d(path: Path, budget: Budget) -> C3dFile:
    """Read a whole file.

    Raises:
        InputError: no C3D file, sizes that do not fit the file, no frames.
    """
    data = path.read_bytes()
    if len(data) < 2 * BLOCK or data[1] != 0x50:
        raise InputError(path, f"second byte {data[1:2].hex() or 'missing'}", "50 as in a C3D file of two blocks or more")
    section = max(data[0] - 1, 1) * BLOCK
    if section + 4 > len(data):
        raise InputError(
            path, f"parameters in block {data[0]}", f"one of the {len(data) // BLOCK} blocks", "The file is damaged."
        )
    processor = data[section + 3]
    if processor not in (_INTEL, _DEC, _MIPS):
        raise InputError(path, f"processor type {processor}", f"{_INTEL} (Intel), {_DEC} (DEC) or {_MIPS} (MIPS)")
    coding = _Coding(">" if processor == _MIPS else "<", processor == _DEC)
    end = min(section + max(data[section + 2], 1) * BLOCK, len(data))
    parameters = dict(_parameters(path, data[section:end], coding))
    return _frames(path, data, coding, parameters, budget)


def _parameters(path: Path, data: bytes, coding: _Coding) -> Iterator[tuple[str, Any]]:
    """All parameters of the parameter section ``data``."""
    groups: dict[int, str] = {}
    waiting: list[tuple[int, str, Any]] = []
    position = 4
    while position + 2 <= len(data):
        length, group = abs(_signed(data[position])), _signed(data[position + 1])
        if length == 0 or group == 0:
            break
        name = _text(data[position + 2 : position + 2 + length]).upper()
        word = position + 2 + length
        if word + 2 > len(data):
            break
        step = int(coding.integers(data[word : word + 2], "u2")[0])
        if group < 0:
            groups[-group] = name
        else:
            waiting.append((group, name, _value(path, name, data, word + 2, coding)))
        if step < 2:
            break
        position = word + step
    for group, name, value in waiting:
        yield f"{groups.get(group, group)}:{name}", value


def _value(path: Path, name: str, data: bytes, at: int, coding: _Coding) -> Any:
    """One parameter: type, number of dimensions, their sizes, values with the first index fastest."""
    kind, dimensions = _signed(_byte(data, at)), _byte(data, at + 1)
    sizes = [_byte(data, at + 2 + i) for i in range(dimensions)]
    start = at + 2 + dimensions
    if kind not in _TYPES:
        raise InputError(f"{path}: {name}", f"type {kind}", "-1 (text), 1, 2 or 4 bytes", "The file is damaged.")
    width = int(_TYPES[kind][1])
    size = math.prod(sizes) * width
    if start + size > len(data):
        found = f"{' × '.join(map(str, sizes))} values of {width} bytes"
        raise InputError(f"{path}: {name}", found, "what fits into the parameter section", "The file is damaged.")
    body = data[start : start + size]
    if kind == -1:
        each = sizes[0] if sizes else 1
        return tuple(_text(body[i : i + each]) for i in range(0, len(body), each)) if each else ()
    if kind == 4:
        return coding.floats(body).astype(np.float64)
    return coding.integers(body, _TYPES[kind]).astype(np.float64)


def _byte(data: bytes, at: int) -> int:
    return data[at] if at < len(data) else 0


def _signed(byte: int) -> int:
    return byte - 256 if byte > 127 else byte


def _text(data: bytes) -> str:
    try:
        return data.decode("utf-8").strip(" \0")
    except UnicodeDecodeError:
        return data.decode("latin-1").strip(" \0")


def _frames(path: Path, data: bytes, coding: _Coding, parameters: Mapping[str, Any], budget: Budget) -> C3dFile:
    words = coding.integers(data[:24], "u2").astype(int)
    points, analog_words, first, last = (int(word) for word in words[1:5])
    samples = int(words[9])
    header_scale, header_rate = float(coding.floats(data[12:16])[0]), float(coding.floats(data[20:24])[0])
    points = _unsigned(_first(parameters, "POINT:USED", points))
    scale, scale_note = _or_header(parameters, "POINT:SCALE", header_scale)
    rate, rate_note = _or_header(parameters, "POINT:RATE", header_rate)
    if not (np.isfinite(rate) and rate > 0.0):
        raise InputError(path, f"a rate of {rate} frames a second", "more than zero", "The file is damaged.")
    if not np.isfinite(scale) or scale == 0.0:
        raise InputError(path, f"a scale of {scale}", "a number other than zero", "The file is damaged.")
    channels = _unsigned(_first(parameters, "ANALOG:USED", analog_words / samples if samples else 0))
    if channels * samples != analog_words:
        found = f"{channels} channels of {samples} samples a frame but {analog_words} in the header"
        raise InputError(path, found, "as many in both", "The file is damaged.")
    width = 4 if scale < 0.0 else 2
    frame = width * (4 * points + analog_words)
    start = (int(words[8]) or int(_first(parameters, "POINT:DATA_START", 0)) or data[0] + data[BLOCK + 2]) - 1
    begin = start * BLOCK
    if frame == 0 or start < 1 or begin + frame > len(data):
        found = f"frames of {frame} bytes from block {start + 1} on"
        raise InputError(path, found, f"at least one in the {len(data)} bytes of the file", "The file is damaged or empty.")
    available = (len(data) - begin) // frame
    first, stated = _range(parameters, first, last, available)
    count = min(stated, available)
    if count < 1:
        raise InputError(path, f"frames {first + 1} to {last}", "at least one frame", "Export the trial again.")
    budget.check_topics(path, points, "points")
    budget.check_numbers(path, count * (3 * points + analog_words))
    body = data[begin : begin + count * frame]
    table = (coding.floats(body) if scale < 0.0 else coding.integers(body)).reshape(count, -1)
    seen = table[:, : 4 * points].reshape(count, points, 4)
    with np.errstate(all="ignore"):  # damaged floats
        where = np.array(seen[:, :, :3], dtype=np.float64) * (1.0 if scale < 0.0 else scale)
    missing = (seen[:, :, 3] < 0) | ~np.isfinite(where).all(axis=2)
    where[missing] = np.nan
    with np.errstate(all="ignore"):
        raw = np.array(table[:, 4 * points :], dtype=np.float64).reshape(count * samples, channels)
        analog = _scaled(raw, channels, parameters)
    return C3dFile(rate, first, where, analog, parameters, stated, (*rate_note, *scale_note))


def _range(parameters: Mapping[str, Any], first: int, last: int, available: int) -> tuple[int, int]:
    """Number of the first frame, counted from 0, and the stated number of frames.

    Up to four places state the number of frames, because long trials exceed the header's 16 bits, and a cropped trial may keep
    its old counts. The largest number that fits into the file is used; if none fits, the file is cut off.
    """
    stated = {last - first + 1, *(_unsigned(_first(parameters, f"POINT:{name}", 0)) for name in ("FRAMES", "LONG_FRAMES"))}
    ends = [parameters.get(f"TRIAL:ACTUAL_{end}_FIELD") for end in ("START", "END")]
    if all(isinstance(end, np.ndarray) and len(end) == 2 for end in ends):
        first, last = (_unsigned(end[0]) + 65536 * _unsigned(end[1]) for end in ends if end is not None)
        stated.add(last - first + 1)
    positive = {frames for frames in stated if frames > 0}
    return max(first - 1, 0), max((frames for frames in positive if frames <= available), default=min(positive, default=0))


def _scaled(raw: Array, channels: int, parameters: Mapping[str, Any]) -> Array:
    """``(raw − offset) · scale · general scale`` of every analog channel."""
    if not channels:
        return raw
    unsigned = "UNSIGNED" in [text.upper() for text in parameters.get("ANALOG:FORMAT", ()) if isinstance(text, str)]
    offset = _each(parameters, "ANALOG:OFFSET", channels, 0.0)
    if unsigned:
        raw, offset = np.where(raw < 0.0, raw + 65536.0, raw), np.where(offset < 0.0, offset + 65536.0, offset)
    general = _first(parameters, "ANALOG:GEN_SCALE", 1.0)
    return np.asarray((raw - offset) * _each(parameters, "ANALOG:SCALE", channels, 1.0) * general)


def _each(parameters: Mapping[str, Any], name: str, count: int, default: float) -> Array:
    """A number for each of ``count`` channels, from a parameter and its continuations."""
    found = [number for part in _continued(parameters, name, np.ndarray) for number in part.tolist()]
    return np.array((found + [default] * count)[:count])


def _continued(parameters: Mapping[str, Any], name: str, kind: type) -> Iterator[Any]:
    """A parameter of this type and its continuations (``LABELS``, ``LABELS2`` …)."""
    values = (parameters.get(f"{name}{suffix}") for suffix in ("", *map(str, range(2, 100))))
    return itertools.takewhile(lambda value: isinstance(value, kind), values)


def _first(parameters: Mapping[str, Any], name: str, default: float) -> float:
    value = parameters.get(name)
    return float(value[0]) if isinstance(value, np.ndarray) and len(value) else float(default)


def _or_header(parameters: Mapping[str, Any], name: str, header: float) -> tuple[float, tuple[str, ...]]:
    """A parameter, or the header's value where it is missing or zero, and a note where both are stated and differ.

    Scales are compared by their sign only, which is the storage: of floats the size of the scale is not used.
    """
    value = _first(parameters, name, 0.0)
    if value == 0.0:
        stated = isinstance(parameters.get(name), np.ndarray)
        return header, (f"{name} is 0: {header:g} of the header is used",) if stated and header != 0.0 else ()
    same = value * header > 0.0 if name.endswith("SCALE") else abs(value - header) <= 1e-4 * abs(value)
    return value, () if same or header == 0.0 else (
        f"{name} is {value:g}, the header states {header:g}: the parameter is used",
    )


def _unsigned(value: float) -> int:
    """A count that was stored as a signed 16-bit word."""
    if not np.isfinite(value):
        return 0
    return int(value) + 65536 if value < 0 else int(value)


#: Model outputs are stored like points; the file lists them under these names, with a unit of their own.
_MODEL_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
ANALOG = "analog"


class C3dReader(LogReader):
    """``capture`` stamps: the number of the frame over the rate, so that a cropped trial does not start at zero."""

    name = "c3d"
    suffixes = (".c3d",)
    clocks = ("capture",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        trial = read_c3d(path, options.budget_of(path, "a C3D file"))
        outputs = _model_outputs(trial)
        names = _names(trial.texts("POINT:LABELS"), trial.points.shape[1], "point")
        options.check_streams(path, [*names, ANALOG] if trial.analog.size else names, "point")
        stated = next((unit for unit in trial.texts("POINT:UNITS") if unit), "")
        markers = any(name not in outputs for name in names)
        factor = length_factor(path, stated, options) if markers else 1.0
        losses = _losses(path, trial)
        frames = np.arange(len(trial.points)) + trial.first
        stamps = {"capture": to_ns(frames / trial.rate, 1.0, str(path))}
        streams = []
        for index, name in enumerate(names):
            if not options.wants(name):
                continue
            unit = outputs.get(name, "m")
            values = trial.points[:, index] * (factor if name not in outputs else 1.0)
            columns = {axis: values[:, i] for i, axis in enumerate("xyz")}
            units = dict.fromkeys(columns, unit) if unit else {}
            kind = "Model Output" if name in outputs else "Marker"
            streams.append(Stream(name, path, stamps, columns, units, losses, kind=kind))
        if trial.analog.size and options.wants(ANALOG):
            streams.append(_analog(path, trial, losses))
        return without_lost(path, streams)


def _analog(path: Path, trial: C3dFile, losses: tuple[str, ...]) -> Stream:
    count, channels = trial.analog.shape
    each = count // len(trial.points)
    samples = np.arange(count) + trial.first * each
    names = _names(trial.texts("ANALOG:LABELS"), channels, "channel")
    stated = trial.texts("ANALOG:UNITS")
    units = {name: unit for name, unit in zip(names, stated, strict=False) if unit}
    columns = {name: trial.analog[:, i] for i, name in enumerate(names)}
    stamps = {"capture": to_ns(samples / (trial.rate * each), 1.0, str(path))}
    return Stream(ANALOG, path, stamps, columns, units, losses, kind="Analog")


def _names(labels: Sequence[str], count: int, what: str) -> list[str]:
    """A unique name for each of ``count`` columns."""
    names: dict[str, None] = {}
    for index in range(count):
        name = labels[index] if index < len(labels) and labels[index] else f"{what} {index + 1}"
        while name in names:
            name += f"#{index + 1}"
        names[name] = None
    return list(names)


def _model_outputs(trial: C3dFile) -> dict[str, str]:
    """Label → unit (as stated, may be empty) of the model outputs among the points."""
    found: dict[str, str] = {}
    for kind in _MODEL_OUTPUTS:
        unit = "".join(trial.texts(f"POINT:{kind[:-1]}_UNITS")[:1])
        found |= dict.fromkeys(trial.texts(f"POINT:{kind}"), unit)
    return found


def _losses(path: Path, trial: C3dFile) -> tuple[str, ...]:
    losses = [f"{path.name}: {note}" for note in trial.notes]
    frames = len(trial.points)
    if frames < trial.stated:
        losses.append(f"{path.name}: the file is cut off: {frames} of {trial.stated} frames are there")
    rotations = trial.parameters.get("ROTATION:USED")
    if isinstance(rotations, np.ndarray) and rotations.any():
        losses.append(f"{path.name}: rotation matrices (ROTATION) are not read")
    return tuple(losses)
