"""Delay of a line: by the machine's stamps and this computer's clock, and by the round trip of commands."""

from __future__ import annotations

import math
from collections import deque

from sysid_rl.run.clock import SECOND

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
#: Statuses that come late for this time are reported [s].
LATE_S = 0.08
#: Frames overtake each other by at most a few cycles [s].
OVERTAKEN_S = 0.05
#: Values that come within this time after a status are of its cycle.
SAME_CYCLE_NS = 5_000_000
#: A clock that was set is reported for this time [s]: every reader of the line sees it, however many frames come at once.
SET_S = 0.2


class MachineClock:
    """Maps the machine's clock to this computer's, by the earliest arrival since the start.

    The status frame at the beginning of a cycle has the machine's time; the values after it were measured then.
    ``arrival − stamp`` is the offset of the clocks plus a delay, which is never negative. The offset is at most the smallest
    difference so far, and this bound grows at most by the drift: ``offset ← min(offset + drift·Δt, arrival − stamp)``.
    A delay that grows faster than the drift is detected.

    No single frame restarts the estimate: stamps are compared modulo their period, one that steps back a little belongs to a
    frame that was overtaken, and only :data:`ANSWERS` frames in a row that contradict the estimate by :data:`OVERTAKEN_S`
    show a clock that was set, which is a fault.

    Args:
        period: time after which the machine's clock begins at zero again [s].
        source: of the machine's time, for messages.
    """

    def __init__(self, period: float = math.inf, source: str = "the machine's clock") -> None:
        self._period, self.source = period, source
        #: Estimated offset, and delay of the newest frame beyond the smallest one [ns].
        self._offset: float | None = None
        self._delay = 0.0
        #: Newest stamp and that of the last frame [ns], periods added up; the latter as it came [s].
        self._newest = self._stamp = 0
        self._seconds: float | None = None
        self._received = 0
        self._contrary = 0
        self._late_ns: int | None = None
        self._set_ns: int | None = None
        self._set_s = 0.0

    def tick(self, seconds: float | None, received_ns: int) -> None:
        """A status with the machine's time [s] arrived; None: without a time."""
        self._seconds = seconds
        if seconds is None:
            return
        passed, self._received = received_ns - self._received, received_ns
        # After half a period of silence the number of periods is not known.
        if self._offset is None or passed > 0.5 * self._period * SECOND:
            self._begin(round(seconds * SECOND), received_ns)
            return
        self._stamp = self._newest + round(self._step(seconds - self._newest / SECOND) * SECOND)
        found = float(received_ns - self._stamp)
        self._offset += DRIFT * passed
        overtaken = OVERTAKEN_S * SECOND
        contrary = self._stamp < self._newest - overtaken or found < self._offset - overtaken
        self._contrary = self._contrary + 1 if contrary else 0
        if self._contrary == ANSWERS:
            self._set_ns, self._set_s = received_ns, (self._offset - found) / SECOND
            self._begin(self._stamp, received_ns)
        elif not contrary:
            self._newest, self._offset = max(self._newest, self._stamp), min(self._offset, found)
            self._delay = found - self._offset
            late = self._delay > ANSWER_S * SECOND
            self._late_ns = None if not late else received_ns if self._late_ns is None else self._late_ns

    def _begin(self, stamp: int, received_ns: int) -> None:
        self._newest = self._stamp = stamp
        self._offset = float(received_ns - stamp)
        self._delay, self._contrary, self._late_ns = 0.0, 0, None

    def _step(self, seconds: float) -> float:
        """``seconds`` within half a period of zero."""
        return seconds if math.isinf(self._period) else seconds - self._period * round(seconds / self._period)

    def measured(self, received_ns: int) -> int:
        """When a value that came at ``received_ns`` was measured, on this computer's clock; ``received_ns`` if unknown."""
        if self._seconds is None or self._offset is None:
            return received_ns
        # At least as late as the last status that fits; by its stamp, if it came in the same cycle.
        late = received_ns - round(self._delay)
        return min(late, round(self._stamp + self._offset)) if received_ns - self._received <= SAME_CYCLE_NS else late

    def now(self, at_ns: int) -> float | None:
        """Lower bound of the machine's time at ``at_ns`` [s]: the newest stamp plus the time since its arrival, without its
        delay; None if unknown."""
        return None if self._seconds is None else self._seconds + (at_ns - self._received) / SECOND

    def late(self, now_ns: int) -> str:
        """A text if the clock was set, or statuses come late; "" otherwise."""
        if self._set_ns is not None and now_ns - self._set_ns < SET_S * SECOND:
            way = "ahead" if self._set_s > 0.0 else "back"
            return f"{self.source} went {way} by {abs(self._set_s):.3g} s: it was set, or the machine has restarted"
        # Frames that waited while this computer stood still come all at once.
        if self._late_ns is not None and self._received - self._late_ns > LATE_S * SECOND:
            return (
                f"the machine's status comes {self._delay / 1e6:.0f} ms late by {self.source}: the delay of the line has grown"
            )
        return ""


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
