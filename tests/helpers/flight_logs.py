"""Logs of autopilots put together by hand: ULog of PX4, DataFlash of ArduPilot."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

#: Types of ULog → struct codes.
ULOG_TYPES = {
    "int8_t": "b", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I", "int64_t": "q",
    "uint64_t": "Q", "float": "f", "double": "d", "bool": "?", "char": "c",
}  # fmt: skip


def _message(kind: str, body: bytes) -> bytes:
    return struct.pack("<Hc", len(body), kind.encode()) + body


def ulog(
    formats: Mapping[str, str], messages: Sequence[tuple[int, bytes] | bytes], subscriptions: Sequence[tuple[str, int]]
) -> bytes:
    """A file.

    Args:
        formats: name → ``"uint64_t timestamp;float[4] q;"``.
        messages: (index of their subscription, body), or whole ones.
        subscriptions: (name of a format, instance).
    """
    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
    data += _message("B", bytes(40))
    data += b"".join(_message("F", f"{name}:{fields}".encode()) for name, fields in formats.items())
    key = b"int32_t SYS_ID"
    data += _message("P", struct.pack("<B", len(key)) + key + struct.pack("<i", 3))
    for number, (name, instance) in enumerate(subscriptions):
        data += _message("A", struct.pack("<BH", instance, number) + name.encode())
    for message in messages:
        data += message if isinstance(message, bytes) else _message("D", struct.pack("<H", message[0]) + message[1])
    return data


def dropout(milliseconds: int) -> bytes:
    """A dropout of the logger in a ULog."""
    return _message("O", struct.pack("<H", milliseconds))


def attitude_ulog(rows: int = 12, instances: int = 2) -> bytes:
    """Attitudes of two estimators, the signals of :mod:`small_logs`: a ramp and its square."""
    messages = [
        (instance, struct.pack("<Q4fh", 5_000_000 + 100_000 * row, 10.0 * row, row**2, 0.5, instance, -row))
        for row in range(rows)
        for instance in range(instances)
    ]
    formats = {
        "vehicle_attitude": "uint64_t timestamp;float ramp;float[2] q;quality state;uint8_t[1] _padding0;",
        "quality": "float share;int16_t count;",
    }
    return ulog(formats, messages, [("vehicle_attitude", instance) for instance in range(instances)])


#: Letters of DataFlash formats → struct codes.
DATAFLASH = {
    "a": "32h", "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "n": "4s", "N": "16s", "Z": "64s",
    "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "d": "d", "M": "B", "q": "q", "Q": "Q", "g": "e",
}  # fmt: skip
_FMT = "BBnNZ"


def dataflash_size(letters: str) -> int:
    """Bytes of a message with its head."""
    return 3 + struct.calcsize("<" + "".join(DATAFLASH[letter] for letter in letters))


def dataflash_message(kind: int, letters: str, values: Sequence[Any]) -> bytes:
    """A message; values of the letter ``a`` as 32 values in a row."""
    return struct.pack("<BBB" + "".join(DATAFLASH[letter] for letter in letters), 0xA3, 0x95, kind, *values)


def dataflash(
    formats: Mapping[str, tuple[int, str, str]],
    messages: Sequence[tuple[str, Sequence[Any]] | bytes],
    units: Mapping[str, tuple[str, str]] | None = None,
) -> bytes:
    """A file.

    Args:
        formats: name → (number of the type, letters, names of the columns).
        messages: (name of the type, values), or bytes.
        units: name → a letter for each column: of its unit (``m`` m, ``d`` deg, ``#`` instance, ``s`` s, ``?`` a strange one),
            and of its multiplier (``F`` 1e-6, ``B`` 1e-2, ``-`` none).
    """
    formats = {
        "UNIT": (0x81, "QbZ", "TimeUS,Id,Label"),
        "MULT": (0x82, "Qbd", "TimeUS,Id,Mult"),
        "FMTU": (0x83, "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    } | dict(formats)
    known = {"FMT": (0x80, _FMT, "Type,Length,Name,Format,Columns")} | formats
    data = b""
    for name, (kind, letters, columns) in known.items():
        data += dataflash_message(
            0x80, _FMT, (kind, dataflash_size(letters), name.encode(), letters.encode(), columns.encode())
        )
    for letter, label in (("m", "m"), ("d", "deg"), ("s", "s"), ("?", "strange"), ("#", "instance")):
        data += dataflash_message(0x81, "QbZ", (0, ord(letter), label.encode()))
    for letter, factor in (("-", 0.0), ("F", 1e-6), ("B", 1e-2)):
        data += dataflash_message(0x82, "Qbd", (0, ord(letter), factor))
    for name, (unit, multiplier) in (units or {}).items():
        data += dataflash_message(0x83, "QBNN", (0, known[name][0], unit.encode(), multiplier.encode()))
    for message in messages:
        data += (
            message if isinstance(message, bytes) else dataflash_message(known[message[0]][0], known[message[0]][1], message[1])
        )
    return data


def attitude_dataflash(rows: int = 12) -> bytes:
    """Attitudes, and accelerations of two sensors."""
    formats = {"ATT": (1, "QcCfZ", "TimeUS,Ramp,Square,Yaw,Text"), "IMU": (2, "QBfh", "TimeUS,I,AccX,Raw")}
    messages: list[tuple[str, Sequence[Any]] | bytes] = []
    for row in range(rows):
        messages.append(("ATT", (5_000_000 + 100_000 * row, 10 * row, row**2, 0.5 * row, b"on")))
        messages += [("IMU", (5_000_000 + 100_000 * row, sensor, 0.5 * row + sensor, -row)) for sensor in (0, 1)]
    units = {"ATT": ("sddm-", "F----"), "IMU": ("s#md", "F--B")}
    return dataflash(formats, messages, units)
