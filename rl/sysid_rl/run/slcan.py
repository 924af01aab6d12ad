"""An adapter on a serial line (slcan): python-can's interface with a robust reader.

The protocol has no checksum, and its answers share the line with the frames: ``\\r`` and ``\\a`` (done, refused), ``z`` and
``Z`` (sent), versions and states. A line that is a complete data frame is decoded; anything else is skipped, and counted if it
begins like a frame. All waiting bytes are read at once, so that answers do not delay the frames behind them.

Source of the lines: Lawicel, CANUSB manual, "ASCII commands".
"""

from __future__ import annotations

import re
import time
from collections import deque
from typing import Any

from can import CanInitializationError, CanOperationError, Message
from can.exceptions import error_check
from can.interfaces.slcan import slcanBus

from sysid_rl.run.serial_line import claim

#: Longest line: T, 8 digits of identifier, length, 8 bytes, 4 digits of the adapter's stamp, and a reserve.
LONGEST = 64
#: Most bytes in the output buffer: four sets of commands.
WAITING = 512
_ENDS = re.compile(rb"[\r\a]")
_FRAME = re.compile(rb"(?:([Tx])([0-9A-Fa-f]{8})|t([0-9A-Fa-f]{3}))([0-8])((?:[0-9A-Fa-f]{2})*)")
#: First letters of data frames, CAN FD included.
_CLAIMS = b"TtxdDbB"


def parse_line(line: bytes) -> Message | None:
    """The data frame in ``line``, without its end; None for everything else, damaged frames included."""
    found = _FRAME.fullmatch(line)
    if found is None:
        return None
    extended = found[1] is not None
    identifier, length = int(found[2] if extended else found[3], 16), int(found[4])
    digits = found[5]
    # Four more digits: the adapter's stamp.
    if len(digits) - 2 * length not in (0, 4) or identifier >= 1 << (29 if extended else 11):
        return None
    return Message(
        arbitration_id=identifier, is_extended_id=extended, data=bytes.fromhex(digits[: 2 * length].decode("ascii")),
        timestamp=time.time(),
    )  # fmt: skip


class SlcanBus(slcanBus):
    """Like :class:`can.interfaces.slcan.slcanBus`, with another reader, and without waiting for the adapter."""

    def __init__(self, channel: str, **options: Any) -> None:
        self._frames: deque[Message] = deque()
        self._rest = b""
        #: Number of damaged frames.
        self.damaged = 0
        super().__init__(channel, **options)
        with error_check(exception_type=CanInitializationError):
            claim(self.serialPortOrig.fileno())

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            if not self._frames:
                self._take()
            if self._frames:
                return self._frames.popleft(), False
            if end is not None and time.monotonic() >= end:
                return None, False
            time.sleep(0.0005)

    def _take(self) -> None:
        """Decode all waiting bytes."""
        with error_check("Could not read from serial device"):
            data = self._rest + self.serialPortOrig.read(max(1, self.serialPortOrig.in_waiting))
        *lines, rest = _ENDS.split(data)
        self._rest = rest[-LONGEST:]  # an endless line is noise
        for line in lines:
            frame = parse_line(line.strip(b"\n"))
            if frame is not None:
                self._frames.append(frame)
            elif line[:1] and line[:1] in _CLAIMS:
                self.damaged += 1

    def _write(self, string: str) -> None:
        with error_check("Could not write to serial device"):
            waiting = self.serialPortOrig.out_waiting
        if waiting > WAITING:
            raise CanOperationError("the adapter takes no frames")
        with error_check("Could not write to serial device"):
            self.serialPortOrig.write(string.encode() + self.LINE_TERMINATOR)
