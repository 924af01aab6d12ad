"""The bus of the simulated test bench on a simulated clock: the frames of a real line, without waiting for real time."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from simulated_bench.live import COLUMNS, LiveProcess
from simulated_bench.live_bus import CanFrame

if TYPE_CHECKING:
    from can import Message

Array = npt.NDArray[np.float64]

#: Begin of the machine's first cycle on the clock of the runner [ns]: the cycles of two computers are not in phase.
PHASE_NS = 4_000_000


class BenchLine:
    """A bus (as python-can has it), a clock, and the switches of the machine, for :class:`sysid_rl.run.can.CanTransport`."""

    def __init__(self, process: LiveProcess) -> None:
        self._process, self._now = process, 0
        self._due = PHASE_NS + process.cycle_ns
        self._frames: deque[CanFrame] = deque()
        self._rows: list[Array] = []

    def now_ns(self) -> int:
        return self._now

    def wait_until(self, ns: int) -> None:
        """Run the machine until then."""
        while self._due <= ns:
            self._now = self._due
            frames, row = self._process.cycle(self._due)
            self._frames.extend(frames)
            self._rows.append(row)
            self._due += self._process.cycle_ns
        self._now = max(self._now, ns)

    def recv(self, timeout: float | None = None) -> Message | None:
        from can import Message

        if not self._frames:
            return None
        frame = self._frames.popleft()
        return Message(arbitration_id=frame.identifier, is_extended_id=frame.extended, data=frame.data)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        frame = CanFrame(msg.arbitration_id, msg.is_extended_id, bytes(msg.data))
        self._process.received_frames([frame], self._now)

    def shutdown(self) -> None:
        """Nothing to close."""

    def set_inputs(self, dead_man: bool | None = None, emergency_stop: bool | None = None) -> None:
        """Set the switches of the machine; None leaves them unchanged."""
        switches = self._process.switches
        switches.dead_man = switches.dead_man if dead_man is None else dead_man
        switches.emergency_stop = switches.emergency_stop if emergency_stop is None else emergency_stop

    @property
    def truth(self) -> Mapping[str, Array]:
        """Columns of the true motion so far (:data:`simulated_bench.live.COLUMNS`), a row each cycle of the machine."""
        return dict(zip(COLUMNS, np.array(self._rows).T, strict=True))
