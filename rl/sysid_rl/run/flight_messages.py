"""A cycle as ROS 2 messages of a flight log."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid_rl.run.cycle import Cycle
from sysid_rl.run.transport import Measurement

Array = npt.NDArray[np.float64]

COMMANDS, CYCLES, VERDICTS, READINGS = "/commands", "/cycles", "/verdicts", "/readings/"
_SEPARATOR = "=" * 80
_HEADER = f"""{_SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
COMMAND_TYPE = f"""# Valve commands as the line carries them, stamped when sent; zeros while the valves are kept neutral.
std_msgs/Header header
string[] name
float64[] command
{_HEADER}"""
READING_TYPE = f"""# One value of a signal (SI), stamped when it was measured.
std_msgs/Header header
float64 value
int64 received_ns
uint64 count
{_HEADER}"""
CYCLE_TYPE = f"""# One cycle of the loop, stamped at its beginning. Axes in the order of name; NaN where something is not known.
std_msgs/Header header
uint64 number
string state
string source
string fault
bool dead_man
bool emergency_stop
bool enabled
int64 due_ns
int64 lateness_ns
int64 latency_ns
string[] name
float64[] joint
float64[] ee
float64[] target
float64[] asked
float64[] setpoint
float64[] drive_setpoint
float64[] command_asked
float64[] command
{_HEADER}"""
VERDICT_TYPE = f"""# A rule of the supervisor that was broken in a cycle.
std_msgs/Header header
uint64 cycle
string check
string target
string reaction
float64 found
float64 limit
string text
{_HEADER}"""


class Cdr:
    """Serialised fields of a message, little endian, each aligned to its size. Source: OMG CDR 1.2, ch. 9.3."""

    def __init__(self, stamp_ns: int) -> None:
        self._body = bytearray()
        self.pack("i", stamp_ns // 1_000_000_000).pack("I", stamp_ns % 1_000_000_000).text("")

    def pack(self, kind: str, value: float) -> Cdr:
        size = struct.calcsize(kind)
        self._body += b"\0" * (-len(self._body) % size) + struct.pack("<" + kind, value)
        return self

    def text(self, value: str) -> Cdr:
        coded = value.encode() + b"\0"
        self.pack("I", len(coded))
        self._body += coded
        return self

    def texts(self, values: Iterable[str]) -> Cdr:
        values = tuple(values)
        self.pack("I", len(values))
        for value in values:
            self.text(value)
        return self

    def array(self, values: Array) -> Cdr:
        self.pack("I", len(values))
        if len(values):
            self._body += b"\0" * (-len(self._body) % 8) + np.asarray(values, "<f8").tobytes()
        return self

    @property
    def data(self) -> bytes:
        return b"\0\1\0\0" + bytes(self._body)


@dataclass(frozen=True)
class OutgoingMessage:
    """A message: topic, times of recording and publication on the log's clock [ns], and its bytes."""

    topic: str
    log_ns: int
    publish_ns: int
    data: bytes


@dataclass
class MessagePublisher:
    """Convert cycles to messages.

    Args:
        axes: names in the order of the arrays.
        offset_ns: from the loop's clock to the log's, fixed for the run: the log's clock never jumps.
    """

    axes: tuple[str, ...]
    offset_ns: int

    def __post_init__(self) -> None:
        self._counts: dict[str, int] = {}

    def topics(self, signals: Iterable[str]) -> Iterator[tuple[str, str, str]]:
        """Topic, type and definition of all messages."""
        yield COMMANDS, "sysid_msgs/msg/Commands", COMMAND_TYPE
        yield CYCLES, "sysid_msgs/msg/Cycle", CYCLE_TYPE
        yield VERDICTS, "sysid_msgs/msg/Verdict", VERDICT_TYPE
        for signal in signals:
            yield READINGS + signal, "sysid_msgs/msg/Reading", READING_TYPE

    def messages(self, cycle: Cycle) -> Iterator[OutgoingMessage]:
        """The messages of a cycle; each reading is sent once."""
        at = cycle.at_ns + self.offset_ns
        for signal, reading in cycle.readings.items():
            if self._counts.get(signal) != reading.count:
                self._counts[signal] = reading.count
                yield self._reading(signal, reading, at)
        sent = at + cycle.latency_ns
        commands = cycle.commands if cycle.enabled else np.zeros(len(self.axes))
        yield OutgoingMessage(COMMANDS, sent, sent, Cdr(sent).texts(self.axes).array(commands).data)
        yield OutgoingMessage(CYCLES, at, at, self._cycle(cycle, at))
        for verdict in cycle.verdicts:
            body = Cdr(at).pack("Q", cycle.number).text(verdict.check).text(verdict.target).text(verdict.reaction)
            yield OutgoingMessage(
                VERDICTS, at, at, body.pack("d", verdict.found).pack("d", verdict.limit).text(verdict.text).data
            )

    def _reading(self, signal: str, reading: Measurement, at: int) -> OutgoingMessage:
        measured, received = reading.measured_ns + self.offset_ns, reading.received_ns + self.offset_ns
        # A stamp before the year 1970, of a wrong clock, cannot be written.
        body = Cdr(max(measured, 0)).pack("d", reading.value).pack("q", received).pack("Q", reading.count)
        return OutgoingMessage(READINGS + signal, at, max(received, 0), body.data)

    def _cycle(self, cycle: Cycle, at: int) -> bytes:
        inputs = cycle.inputs
        body = Cdr(at).pack("Q", cycle.number).text(cycle.state).text(cycle.source).text(inputs.fault)
        body.pack("?", inputs.dead_man).pack("?", inputs.emergency_stop).pack("?", cycle.enabled)
        body.pack("q", cycle.due_ns + self.offset_ns).pack("q", cycle.lateness_ns).pack("q", cycle.latency_ns)
        body.texts(self.axes).array(cycle.joints).array(cycle.ee).array(cycle.target).array(cycle.requested)
        return (
            body.array(cycle.setpoints).array(cycle.drive_setpoints).array(cycle.requested_commands).array(cycle.commands).data
        )
