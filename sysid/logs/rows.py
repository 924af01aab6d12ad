"""Messages decoded one by one → columns: JSON and protobuf, whose layout differs in every message."""

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
from sysid.logs.layout import MAX_ELEMENTS, Bytes
from sysid.logs.limits import MAX_DEPTH
from sysid.logs.topic_columns import STAMP_FIELDS, TopicColumns

#: Messages that are Python objects at the same time.
_BATCH = 4096
#: Values of one JSON message, and bytes of one protobuf message; as objects they take many times as much memory.
_MAX_VALUES, _MAX_MESSAGE = 2**20, 16 * 2**20

#: Message → nested dictionaries, lists, numbers; raises ValueError for a message that cannot be read.
Parse = Callable[[bytes], Any]


@dataclass
class RowDecoder:
    """Turns the messages of one topic into columns. Arguments as of :class:`sysid.logs.cdr.ColumnDecoder`."""

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
                if not stamps_only or path in _STAMPS:
                    rows.setdefault(path, []).append(first + offset)
                    values.setdefault(path, []).append(value)
        for path, column in values.items():
            self.columns.put((path,), np.array(rows[path], dtype=np.intp), _numbers(column))


_STAMPS = frozenset(path for pair in STAMP_FIELDS for path in pair)


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
