"""Faults of the line between simulated test bench and runner: delays, disorder, an adapter that loses what it acknowledges."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from simulated_bench.live_bus import CanFrame

#: A status frame is overtaken by the next one so often [cycles].
OVERTAKEN_EVERY = 60


def parse_number(text: str) -> float:
    """A finite number; ValueError for anything else."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(text)
    return number


@dataclass
class Delay:
    """A delay that may grow.

    Args:
        seconds: at the beginning [s]. growth: of it [s/s].
    """

    seconds: float = 0.0
    growth: float = 0.0
    _since_ns: int | None = None

    def at(self, now_ns: int) -> int:
        """The delay at ``now_ns`` [ns]; it grows from the first call on."""
        if self._since_ns is None:
            self._since_ns = now_ns
        return round(self.seconds * 1e9 + self.growth * (now_ns - self._since_ns))


@dataclass
class LineFaults:
    """What the line does to frames; nothing by default.

    Args:
        commands, frames: delay of frames to the machine, and to the runner.
        overtakes: every :data:`OVERTAKEN_EVERY` cycles a status frame comes after the next one.
        swallows: the adapter acknowledges frames of the runner, and does not send them.
        answers: acknowledgements in each cycle for frames that nobody sent.
    """

    commands: Delay = field(default_factory=Delay)
    frames: Delay = field(default_factory=Delay)
    overtakes: bool = False
    swallows: bool = False
    answers: int = 0
    _held: CanFrame | None = None
    _waiting: list[tuple[int, list[CanFrame]]] = field(default_factory=list)

    def apply(self, word: str, values: list[str]) -> None:
        """Apply a line of the control pipe; ValueError for an invalid one."""
        numbers = [parse_number(value) for value in values]
        if word in ("late_commands", "late_frames"):
            milliseconds, growth = numbers
            setattr(self, word.removeprefix("late_"), Delay(1e-3 * milliseconds, 1e-3 * growth))
        elif word in ("overtake", "swallow"):
            (number,) = numbers
            setattr(self, f"{word}s", bool(number))
        elif word == "answers":
            self.answers = int(*numbers)
        else:
            raise ValueError(word)

    def sent(self, frames: list[CanFrame], status: int, cycle: int, now_ns: int) -> None:
        """The machine sends the frames of a cycle, whose status has the identifier ``status``."""
        frames = list(frames)
        own = next((frame for frame in frames if frame.identifier == status), None)
        if self._held is not None:
            frames.insert(frames.index(own) + 1 if own is not None else 0, self._held)
            self._held = None
        elif self.overtakes and own is not None and cycle % OVERTAKEN_EVERY == 0:
            frames.remove(own)
            self._held = own
        self._waiting.append((now_ns + self.frames.at(now_ns), frames))

    def due_ns(self) -> int | None:
        """When the next frames reach the runner; None if there are none."""
        return self._waiting[0][0] if self._waiting else None

    def arrived(self, now_ns: int) -> list[CanFrame]:
        """Frames that have reached the runner."""
        found: list[CanFrame] = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            found += self._waiting.pop(0)[1]
        return found
