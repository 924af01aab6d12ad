"""Messages of a topic → columns: CDR (ROS 2) and packed (ROS 1), many messages at once; JSON and protobuf, whose layout differs
in every message, one by one.

Of a CDR message one is parsed to find its layout (:mod:`sysid.logs.layout`). Every other message with the same length words,
byte order and naming strings has the same layout, and NumPy extracts its columns. A message that matches no known layout is
parsed next.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.labels import ArrayLabels, are_joint_names, are_names, bracketed, identifying
from sysid.logs.layout import MAX_ELEMENTS, Bytes, Layout, layout_of
from sysid.logs.limits import MAX_DEPTH
from sysid.logs.rosmsg import Definition
from sysid.logs.topic_columns import STAMP_PATHS, TopicColumns

Rows = npt.NDArray[np.intp]

#: Layouts of one message size that are kept.
MAX_LAYOUTS = 64
#: Key of layouts that do not depend on the size of the message.
_ANY_SIZE = -1
#: Bytes of messages that are compared at once.
_GATHERED = 16 * 2**20


@dataclass(frozen=True)
class _Messages:
    """Messages ``buffer[start : start + size]``, of which the first is row ``first`` of the columns."""

    buffer: Bytes
    starts: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    first: int


@dataclass
class ColumnDecoder:
    """Turns the messages of one topic into columns, batch by batch.

    Args:
        definition: their type.
        wanted: fields to read besides the stamps; None for all.
        preview: number of messages of which all fields are read; of later ones only the stamps.
        packed: serialised by ROS 1.
        cells: limit of the topic's table where ``wanted`` is None.
    """

    definition: Definition
    wanted: frozenset[str] | None = None
    preview: int | None = None
    packed: bool = False
    cells: int = 2**28
    columns: TopicColumns = field(init=False)
    reason: str = ""
    _layouts: dict[int, list[Layout]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.columns = TopicColumns(self.wanted, self.cells)
        if self.wanted is not None:
            self.wanted |= self.definition.stamp_fields()

    def add(self, buffer: Bytes, starts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]) -> None:
        """Decode messages ``buffer[start : start + size]``; their values are copied."""
        if self.preview is not None and self.columns.total >= self.preview:
            self._stamps_only()
        messages = _Messages(buffer, starts, sizes, self.columns.expect(len(starts)))
        if self.wanted is not None and not self.wanted:
            return
        left = self._decode_known(_ANY_SIZE, messages, np.arange(len(starts)))
        while len(left):
            same_size = sizes[left] == sizes[left[0]]
            own = self._decode_known(int(sizes[left[0]]), messages, left[same_size])
            left = np.union1d(own, left[~same_size]) if len(own) else left[~same_size]
            if len(own):
                left = self._decode_like(int(own[0]), messages, left)

    def _stamps_only(self) -> None:
        """From here on only the stamps are read."""
        self.preview = None
        self.columns.stamps_only()
        self.wanted = self.definition.stamp_fields()
        self._layouts.clear()

    def _decode_like(self, row: int, messages: _Messages, left: Rows) -> Rows:
        """Parse message ``row`` and decode all with the same layout; returns the others."""
        start, sizes = messages.starts[row], messages.sizes
        try:
            data = messages.buffer[start : start + sizes[row]].tobytes()
            layout = layout_of(data, self.definition, self.wanted, self.packed)
        except IndexError as error:
            self.columns.bad.append(messages.first + row)
            self.reason = self.reason or str(error)
            return np.asarray(left[left != row], dtype=np.intp)
        known = self._layouts.setdefault(layout.size if layout.whole else _ANY_SIZE, [])
        known.append(layout)
        del known[:-MAX_LAYOUTS]
        for array, texts in layout.texts.items():
            self.columns.labels.saw(array, texts)
        fits = sizes[left] == layout.size if layout.whole else sizes[left] >= layout.size
        rest = np.union1d(self._decode(layout, messages, left[fits]), left[~fits])
        return np.asarray(rest, dtype=np.intp)

    def _decode_known(self, key: int, messages: _Messages, left: Rows) -> Rows:
        """Decode the messages with one of the layouts under ``key``; returns the others."""
        for layout in reversed(self._layouts.get(key, [])):
            if not len(left):
                break
            long_enough = left if key != _ANY_SIZE else left[messages.sizes[left] >= layout.size]
            if len(long_enough):
                rest = self._decode(layout, messages, long_enough)
                left = rest if len(long_enough) == len(left) else np.union1d(rest, left[messages.sizes[left] < layout.size])
        return left

    def _decode(self, layout: Layout, messages: _Messages, left: Rows) -> Rows:
        """Extract the columns of the messages with ``layout``; returns the others."""
        count = max(1, _GATHERED // max(1, layout.span))
        rest = [self._decode_chunk(layout, messages, left[k : k + count]) for k in range(0, len(left), count)]
        return rest[0] if len(rest) == 1 else np.concatenate(rest)

    def _decode_chunk(self, layout: Layout, messages: _Messages, left: Rows) -> Rows:
        data = gather(messages.buffer, messages.starts[left], layout.span)
        same = np.all(data[:, layout.fixed] == layout.template, axis=1)
        everyone = bool(same.all())
        rows = (left if everyone else left[same]) + messages.first
        if len(rows):
            for array, texts in layout.texts.items():
                self.columns.labels.repeated(array, texts, len(rows))
        if len(rows) and layout.numbers:
            records = layout.records(data if everyone else data[same])
            for path, names in layout.names.items():
                if self.wanted is None or any(name in self.wanted for name in names):
                    self.columns.put(names, rows, records[path])
                else:
                    for name in names:
                        self.columns.know(name)
        rest: Rows = left[:0] if everyone else left[~same]
        return rest


def gather(buffer: Bytes, starts: npt.NDArray[np.int64], size: int) -> Bytes:
    """Rows of ``size`` bytes from any positions, (n, size): one memory copy a row."""
    if size == 0:
        return np.zeros((len(starts), 0), np.uint8)
    windows = np.ndarray((len(buffer) - size + 1,), dtype=f"V{size}", buffer=buffer, strides=(1,))
    return np.ascontiguousarray(windows[starts]).view(np.uint8).reshape(len(starts), size)


#: Messages that are Python objects at the same time.
_BATCH = 4096
#: Values of one JSON message, and bytes of one protobuf message; as objects they take many times as much memory.
_MAX_VALUES, _MAX_MESSAGE = 2**20, 16 * 2**20

#: Message → nested dictionaries, lists, numbers; raises ValueError for a message that cannot be read.
Parse = Callable[[bytes], Any]


@dataclass
class RowDecoder:
    """Turns the messages of one topic into columns. Arguments as of :class:`sysid.logs.messages.ColumnDecoder`."""

    parse: Parse
    wanted: frozenset[str] | None = None
    preview: int | None = None
    cells: int = 2**28
    columns: TopicColumns = field(init=False)
    reason: str = ""

    def __post_init__(self) -> None:
        self.columns = TopicColumns(self.wanted, self.cells)

    def add(self, buffer: Bytes, starts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]) -> None:
        """Decode messages ``buffer[start : start + size]``."""
        for begin in range(0, len(starts), _BATCH):
            self._add(buffer, starts[begin : begin + _BATCH], sizes[begin : begin + _BATCH])

    def _add(self, buffer: Bytes, starts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]) -> None:
        stamps_only = self.preview is not None and self.columns.total >= self.preview
        if stamps_only:
            self.columns.stamps_only()
        first = self.columns.expect(len(starts))
        rows: dict[str, list[int]] = {}
        values: dict[str, list[float]] = {}
        for offset, (start, size) in enumerate(zip(starts.tolist(), sizes.tolist(), strict=True)):
            flat: dict[str, float] = {}
            try:
                flatten(self.parse(buffer[start : start + size].tobytes()), "", flat, labels=self.columns.labels)
            except (ValueError, RecursionError) as error:
                self.columns.bad.append(first + offset)
                self.reason = self.reason or str(error).splitlines()[0][:200]
                continue
            for path, value in flat.items():
                if not stamps_only or path in STAMP_PATHS:
                    rows.setdefault(path, []).append(first + offset)
                    values.setdefault(path, []).append(value)
        for path, column in values.items():
            self.columns.put((path,), np.array(rows[path], dtype=np.intp), _numbers(column))


def _numbers(values: list[float]) -> npt.NDArray[Any]:
    """Integers stay integers, because a stamp in nanoseconds does not fit a float."""
    if all(isinstance(value, int) and -(2**63) <= value < 2**63 for value in values):
        return np.array(values, dtype=np.int64)
    return np.array([float(value) if abs(value) < 1e300 else math.inf for value in values])


def flatten(
    value: Any,
    path: str,
    into: dict[str, float],
    depth: int = 0,
    labelled: str | None = None,
    joints: Sequence[tuple[str, ...]] = (),
    labels: ArrayLabels | None = None,
) -> None:
    """Numbers of nested dictionaries and lists by their path: ``pose.position.x``, ``position[2]``, ``position[boom]``.

    Args:
        path, labelled: of ``value``, by indices and by labels (:mod:`sysid.logs.labels`).
        into: takes the numbers.
        joints: joint names of the objects around this one.
        labels: takes the labels of arrays.
    """
    labelled = path if labelled is None else labelled
    if depth > MAX_DEPTH:
        raise ValueError(f"more than {MAX_DEPTH} levels of objects")
    if isinstance(value, bool | int | float):
        if path:
            into[path] = into[labelled] = int(value) if isinstance(value, bool) else value
    elif isinstance(value, dict):
        own = {
            key: tuple(texts) for key, texts in value.items() if isinstance(texts, list) and are_names(key) and _is_names(texts)
        }
        joints = [texts for key, texts in own.items() if are_joint_names(key)] if own else joints
        names = list(own.values()) or joints
        for key, inner in value.items():
            end = f".{key}" if path else str(key)
            if isinstance(inner, list) and key not in own and 0 < len(inner) <= MAX_ELEMENTS:
                texts = _texts(inner, names, joints)
                if labels is not None and any(texts):
                    labels.saw(path + end, texts)
                    labels.repeated(path + end, texts)
                brackets = bracketed(texts) if texts else ()
                for index, item in enumerate(inner):
                    label = (brackets[index] if brackets else "") or str(index)
                    above = f"{labelled}{end}[{label}]"
                    flatten(item, f"{path}{end}[{index}]", into, depth + 2, above, joints, labels)
            else:
                flatten(inner, path + end, into, depth + 1, labelled + end, joints, labels)
    elif isinstance(value, list) and len(value) <= MAX_ELEMENTS:
        for index, inner in enumerate(value):
            flatten(inner, f"{path}[{index}]", into, depth + 1, f"{labelled}[{index}]", joints, labels)


def _texts(elements: list[Any], names: Sequence[tuple[str, ...]], joints: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """The text that labels each element of a list; none where nothing does."""
    objects = [element for element in elements if isinstance(element, dict)]
    if objects and len(objects) == len(elements):
        key = identifying(tuple(key for key, text in objects[0].items() if isinstance(text, str)))
        texts = tuple(text for element in objects if isinstance(text := element.get(key), str)) if key is not None else ()
        if len(texts) == len(objects):
            return texts
    series = any(_has_series(element) for element in objects)
    return next((own for own in names if len(own) == len(elements) and not (series and own in joints)), ())


def _has_series(value: dict[str, Any]) -> bool:
    """As :meth:`sysid.logs.rosmsg.Definition.has_series`."""
    lists = {key: inner for key, inner in value.items() if isinstance(inner, list)}
    return bool(lists) and not any(_is_names(inner) and are_names(key) for key, inner in lists.items())


def _is_names(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(name, str) for name in value)


def parse_json(data: bytes) -> Any:
    """One JSON message.

    Raises:
        ValueError: no JSON, no object, or one of too many values.
    """
    if data.count(b",") + data.count(b"[") + data.count(b"{") > _MAX_VALUES:
        raise ValueError(f"JSON of more than {_MAX_VALUES} values")
    value = json.loads(data)
    if not isinstance(value, dict):
        raise ValueError(f"JSON of type {type(value).__name__} instead of an object")
    return value


def protobuf_parser(name: str, schema: bytes, where: object) -> Parse:
    """A parser of messages of type ``name``; ``schema`` is a serialised ``FileDescriptorSet``.

    Raises:
        InputError: the schema is damaged or does not define the type.
    """
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from google.protobuf.message import DecodeError

    place = f"{where}: schema {name}"
    pool = descriptor_pool.DescriptorPool()
    try:
        files = {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(schema).file}
        for file in _in_order(_with_well_known(files)):
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    except (DecodeError, TypeError, KeyError, ValueError) as error:
        expected = "a FileDescriptorSet with all the files that the type needs"
        raise InputError(
            place, f"a protobuf schema that cannot be read ({str(error).strip() or 'damaged'})", expected
        ) from None

    def parse(data: bytes) -> Any:
        if len(data) > _MAX_MESSAGE:
            raise ValueError(f"a protobuf message of more than {_MAX_MESSAGE // 2**20} MiB")
        message = kind()
        try:
            message.ParseFromString(data)
        except DecodeError as error:
            raise ValueError(str(error)) from None
        return _fields(message, 0)

    return parse


def _with_well_known(files: dict[str, Any]) -> dict[str, Any]:
    """``files`` and Google's well-known ones (timestamp, duration) that some writers omit."""
    from google.protobuf import descriptor_pb2, duration_pb2, timestamp_pb2

    for module in (duration_pb2, timestamp_pb2):
        name = module.DESCRIPTOR.name
        if name not in files and any(name in file.dependency for file in files.values()):
            files[name] = descriptor_pb2.FileDescriptorProto.FromString(module.DESCRIPTOR.serialized_pb)
    return files


def _in_order(files: Mapping[str, Any]) -> list[Any]:
    """Descriptor files, each after those it imports; the library reports circular imports."""
    done: dict[str, Any] = {}
    left = dict(files)
    while left:
        ready = [name for name, file in left.items() if all(d in done or d not in files for d in file.dependency)]
        for name in ready or list(left):
            done[name] = left.pop(name)
    return list(done.values())


def _fields(message: Any, depth: int) -> dict[str, Any]:
    """A protobuf message as nested dictionaries, including fields at their default."""
    if depth > MAX_DEPTH:
        raise ValueError(f"more than {MAX_DEPTH} levels of messages")
    result: dict[str, Any] = {}
    for descriptor in message.DESCRIPTOR.fields:
        name = descriptor.name
        is_message = descriptor.message_type is not None
        if is_message and descriptor.message_type.GetOptions().map_entry:
            continue
        if descriptor.is_repeated:
            values = getattr(message, name)
            if len(values) <= MAX_ELEMENTS:
                result[name] = [_fields(value, depth + 1) if is_message else value for value in values]
        elif is_message:
            if message.HasField(name):
                result[name] = _fields(getattr(message, name), depth + 1)
        else:
            result[name] = getattr(message, name)
    return result
