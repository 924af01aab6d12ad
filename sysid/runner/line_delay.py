"""Delay of a line: by the machine's stamps and this computer's clock, and by the round trip of commands."""

from __future__ import annotations

from collections import deque

from sysid.runner.clock import SECOND

#: Largest relative drift of two clocks [s/s]. A quartz is within ±100 ppm over −40 … 85 °C: ±20 to 30 ppm initially, ±30 to
#: 50 by temperature, ±3 a year by ageing; two of them: 200 ppm. A computer's clock under correction (NTP: at most 500 ppm)
#: exceeds that for the time of the correction, and appears as a delay of at most three fifths of the correction.
DRIFT = 200e-6
#: Longest round trip on a line in time [s]. A command waits for the machine's next status (one cycle), which waits for the
#: runner's next cycle: 25 ms at 100 Hz is usual.
ANSWER_S = 0.06
#: Late answers in a row for a violation: other checks detect a single delayed cycle.
ANSWERS = 8
#: No answer for this time counts as late [s].
SILENCE_S = 0.15


class MachineClock:
    """Maps the machine's clock to this computer's, by the earliest arrival since the start.

    The status frame at the beginning of a cycle has the machine's time; the values after it were measured then.
    ``arrival − stamp`` is the offset of the clocks plus a delay, which is never negative. The offset is at most the smallest
    difference so far, and this bound grows at most by the drift: ``offset ← min(offset + drift·Δt, arrival − stamp)``.
    A delay that grows faster than the drift is detected.
    """

    def __init__(self) -> None:
        self._offset: float | None = None
        self._stamp: int | None = None
        self._received = 0

    def tick(self, seconds: float | None, received_ns: int) -> None:
        """A status with the machine's time [s] arrived; None: without a time."""
        passed, self._received = received_ns - self._received, received_ns
        if seconds is None:
            self._stamp = None
            return
        stamp = round(seconds * SECOND)
        # A decreasing stamp: the clock was set, or has overflowed.
        begins = self._offset is None or self._stamp is None or stamp < self._stamp
        found = float(received_ns - stamp)
        self._offset = found if begins or self._offset is None else min(self._offset + DRIFT * passed, found)
        self._stamp = stamp

    def measured(self, received_ns: int) -> int:
        """When a value that came at ``came_ns`` was measured, on this computer's clock; ``received_ns`` if unknown."""
        # After a lost status the values would get the stamp of the cycle before.
        if self._stamp is None or self._offset is None or received_ns - self._received > SECOND // 200:
            return received_ns
        return round(self._stamp + self._offset)

    def now(self, at_ns: int) -> float | None:
        """Lower bound of the machine's time at ``at_ns`` [s]: the newest stamp plus the time since its arrival, without its
        delay; None if unknown."""
        return None if self._stamp is None else (self._stamp + at_ns - self._received) / SECOND


class CommandRoundTrip:
    """Time from a command to the first status that echoes it."""

    def __init__(self) -> None:
        self._sent: dict[int, int] = {}
        self._trips: deque[int] = deque(maxlen=ANSWERS)
        self._echo: int | None = None
        self._open_ns: int | None = None

    def sent(self, count: int, now_ns: int) -> None:
        """A set of commands with alive counter ``count`` was sent."""
        self._sent[count] = now_ns
        if self._open_ns is None:
            self._open_ns = now_ns

    def echoed(self, echo: int, now_ns: int) -> None:
        """A status with the echoed counter ``echo`` arrived."""
        if echo == self._echo:
            return
        # The first one may belong to an earlier runner.
        first, self._echo = self._echo is None, echo
        sent = self._sent.get(echo)
        if first or sent is None:
            return
        self._trips.append(now_ns - sent)
        later = [at for at in self._sent.values() if at > sent]
        self._open_ns = min(later, default=None)

    def late(self, now_ns: int) -> str:
        """A text if commands are answered late or not at all; "" otherwise."""
        if len(self._trips) == ANSWERS and (least := min(self._trips)) > ANSWER_S * SECOND:
            return f"commands are answered after {least / 1e6:.0f} ms (at most {1e3 * ANSWER_S:.0f}): the line is late"
        if self._open_ns is not None and now_ns - self._open_ns > SILENCE_S * SECOND:
            return f"commands are not answered for {1e3 * SILENCE_S:.0f} ms: they do not arrive, or arrive late"
        return ""
