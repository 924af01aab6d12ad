"""How late a line is: by the machine's stamps against this computer's clock, and by how soon the machine answers a command."""

from __future__ import annotations

from collections import deque

from sysid.runner.clock import SECOND

#: By how much two clocks may drift apart [s/s]. A quartz keeps ±100 ppm over −40 … 85 °C: ±20 to 30 ppm as it is bought, ±30 to
#: 50 with temperature, ±3 a year with age. Two of them: 200 ppm. A computer's clock that is being corrected (NTP: at most
#: 500 ppm) goes beyond that for as long as it takes, and looks like a delay of three fifths of the correction at the most.
DRIFT = 200e-6
#: An answer later than this says that the line is late [s]. A command waits for the machine's next status (one cycle), which
#: waits for the runner's next cycle (another): 25 ms at 100 Hz where all is well.
ANSWER_S = 0.06
#: So many answers in a row have to be late: what holds up one cycle of this computer is the business of other checks.
ANSWERS = 8
#: No answer at all for so long is one that is late [s].
SILENCE_S = 0.15


class MachineClock:
    """The machine's clock seen from here: the earliest arrival since the start says best when a stamp was.

    The machine states its time in the status frame that begins a cycle; values after it were measured then. ``arrival − stamp``
    is the offset of the clocks plus a delay, which is never negative. The offset is at most the smallest difference so far, and
    that bound rises by no more than the clocks can drift apart: ``offset ← min(offset + drift·Δt, arrival − stamp)``.
    A delay that grows faster than ``drift`` is seen as one, however slowly it does.
    """

    def __init__(self) -> None:
        self._offset: float | None = None
        self._stamp: int | None = None
        self._received = 0

    def tick(self, seconds: float | None, received_ns: int) -> None:
        """A status came with the machine's time in it [s]; None: it says none."""
        passed, self._received = received_ns - self._received, received_ns
        if seconds is None:
            self._stamp = None
            return
        stamp = round(seconds * SECOND)
        # No delay makes stamps go back: the clock was set, or has turned over.
        begins = self._offset is None or self._stamp is None or stamp < self._stamp
        found = float(received_ns - stamp)
        self._offset = found if begins or self._offset is None else min(self._offset + DRIFT * passed, found)
        self._stamp = stamp

    def measured(self, received_ns: int) -> int:
        """When a value that came at ``came_ns`` was measured, on this computer's clock; when it came where nothing says."""
        # A status that was lost would stamp the values of its cycle with the cycle before.
        if self._stamp is None or self._offset is None or received_ns - self._received > SECOND // 200:
            return received_ns
        return round(self._stamp + self._offset)

    def now(self, at_ns: int) -> float | None:
        """The least that the machine's clock shows at ``at_ns`` of this one [s]; None where it says nothing.

        The newest stamp, and what has passed since it came: how long it was on its way is left out.
        """
        return None if self._stamp is None else (self._stamp + at_ns - self._received) / SECOND


class CommandRoundTrip:
    """From a command to the first status that says that it was heard."""

    def __init__(self) -> None:
        self._sent: dict[int, int] = {}
        self._trips: deque[int] = deque(maxlen=ANSWERS)
        self._echo: int | None = None
        self._open_ns: int | None = None

    def sent(self, count: int, now_ns: int) -> None:
        """A set of commands with alive counter ``count`` is out."""
        self._sent[count] = now_ns
        if self._open_ns is None:
            self._open_ns = now_ns

    def echoed(self, echo: int, now_ns: int) -> None:
        """A status came: the newest counter that the machine has heard is ``echo``."""
        if echo == self._echo:
            return
        # The first one may be of somebody who commanded before.
        first, self._echo = self._echo is None, echo
        sent = self._sent.get(echo)
        if first or sent is None:
            return
        self._trips.append(now_ns - sent)
        later = [at for at in self._sent.values() if at > sent]
        self._open_ns = min(later, default=None)

    def late(self, now_ns: int) -> str:
        """That commands are answered late, or not at all; "" where they are not, or nothing was sent."""
        if len(self._trips) == ANSWERS and (least := min(self._trips)) > ANSWER_S * SECOND:
            return f"commands are answered after {least / 1e6:.0f} ms (at most {1e3 * ANSWER_S:.0f}): the line is late"
        if self._open_ns is not None and now_ns - self._open_ns > SILENCE_S * SECOND:
            return f"commands are not answered for {1e3 * SILENCE_S:.0f} ms: they do not arrive, or come late"
        return ""
