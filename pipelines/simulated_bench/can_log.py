"""The machine's log as its CAN bus carries it: three frames a controller cycle, in Vector's binary (BLF) or text (ASC) format.

Valve commands and draw wires are proprietary J1939 messages with 29-bit identifiers and little endian signals, which for the
wires do not end at bytes; the slewing sensor is a CANopen encoder with an 11-bit identifier and a big endian signal. The logger
stamps a frame when it sees it: there is no stamp of when a value was measured. Values are rounded to the bits of the database:
1e-4 of a command, 10 µm, 1 µrad.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt
from can import ASCWriter, BLFWriter, Message
from cantools.database.conversion import BaseConversion

from simulated_bench.recipe import AXES, WIRED
from simulated_bench.run import MachineLog

if TYPE_CHECKING:
    from cantools.database.can import Message as Description
    from cantools.database.can import Signal

#: Messages in the order of the columns of ``MachineLog.published``.
MESSAGES = ("VALVE_COMMAND", "DRAW_WIRES", "SLEW_SENSOR")


def database() -> tuple[Description, ...]:
    """The three messages."""
    from cantools.database.can import Message as Description
    from cantools.database.can import Signal

    def signal(name: str, start: int, length: int, scale: float, unit: str, big: bool = False, signed: bool = True) -> Signal:
        order: Literal["big_endian", "little_endian"] = "big_endian" if big else "little_endian"
        conversion = BaseConversion.factory(scale, 0)
        return Signal(name, start, length, order, is_signed=signed, conversion=conversion, unit=unit, receivers=["LOGGER"])

    commands = [signal(axis, 16 * i, 16, 1e-4, "") for i, axis in enumerate(AXES)]
    wires = [signal(axis, 21 * i, 21, 1e-5, "m") for i, axis in enumerate(WIRED)]
    slew = [signal("slew", 7, 24, 1e-6, "rad", big=True), signal("counter", 24, 8, 1, "", signed=False)]

    def message(identifier: int, name: str, sender: str, signals: list[Signal]) -> Description:
        extended = identifier > 0x7FF
        return Description(identifier, name, 8, signals, senders=[sender], cycle_time=10, is_extended_frame=extended)

    return (
        message(0x0CFF1027, MESSAGES[0], "CONTROLLER", commands),
        message(0x18FF2031, MESSAGES[1], "WIRES", wires),
        message(0x1A7, MESSAGES[2], "ENCODER", slew),
    )


def write_dbc(path: Path) -> None:
    """Write the database of the bus."""
    from cantools.database.can import Database, Node

    nodes = [Node(name, None) for name in ("CONTROLLER", "WIRES", "ENCODER", "LOGGER")]
    described = Database(messages=list(database()), nodes=nodes, version="1")
    path.write_text(described.as_dbc_string().replace("\r\n", "\n"), "cp1252", newline="\r\n")


def write_can(log: MachineLog, path: Path) -> None:
    """Write ``log`` as ``.blf`` or ``.asc``, by the suffix of ``path``; frames in the order in which the bus carried them."""
    described = database()
    raws = (log.command, log.wires, np.column_stack([log.slew, np.arange(len(log.slew)) % 256]))
    payloads = [_payloads(message, values) for message, values in zip(described, raws, strict=True)]
    writer = BLFWriter(path, channel=1) if path.suffix == ".blf" else ASCWriter(path)
    with writer:
        for place in np.argsort(log.published.ravel(), kind="stable"):
            cycle, column = divmod(int(place), len(described))
            message = described[column]
            writer.on_message_received(
                Message(
                    timestamp=int(log.published[cycle, column]) * 1e-9,
                    arbitration_id=message.frame_id,
                    is_extended_id=message.is_extended_frame,
                    data=payloads[column][cycle],
                    channel=0,
                )
            )
    if path.suffix == ".asc":
        _date(path, int(log.published.min()))


def _payloads(message: Description, values: npt.NDArray[np.float64]) -> list[bytes]:
    """Payload of each row of ``values`` (n, k), one column a signal of ``message``."""
    scales = np.array([float(signal.scale) for signal in message.signals])
    names = [signal.name for signal in message.signals]
    rows = np.rint(values / scales).astype(np.int64).tolist()
    return [message.encode(dict(zip(names, row, strict=True)), scaling=False) for row in rows]


def _date(path: Path, start_ns: int) -> None:
    """The writer dates the text format by today's clock and the local time zone; a simulated log is dated by its own."""
    moment = datetime.fromtimestamp(start_ns // 1_000_000_000, UTC)
    date = f"{moment:%a %b %d %H:%M:%S}.{start_ns // 1_000_000 % 1000:03d} {moment:%Y}"
    text = path.read_text("utf-8")
    text = re.sub(r"\Adate .*", f"date {date}", text, count=1)
    path.write_text(re.sub(r"^Begin Triggerblock .*", f"Begin Triggerblock {date}", text, count=1, flags=re.MULTILINE), "utf-8")
