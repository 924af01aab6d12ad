"""What a gap result states: the verdict and its sentence, from the errors on held-out recordings.

Console, report, pages, JSON and Rerun recording take both from here, so that no two of them can differ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from sysid.display import quantity, ratio
from sysid.gap.thresholds import AGREES

Verdict = Literal["named", "no_gap", "unnamed", "ambiguous", "insufficient_excitation"]
#: How a noise floor is known: from the data sheet; from readings at rest that are repeats; from a second sensor; from the
#: sensor's samples, above the bandwidth of the motion; not from anything but the error itself.
FloorSource = Literal["stated", "rest", "two_sensors", "above_bandwidth", "unknown"]

#: Largest noise floor, as a share of the motion, at which agreement says something.
LARGEST_FLOOR = 0.1
#: A free run that is off by these multiples of the motion and of the noise floor does not follow the machine at all.
AWAY, AWAY_FLOORS = 3.0, 10.0

HEADLINES = {
    "no_gap": "The simulation agrees with the machine to within sensor noise.",
    "unnamed": "The simulation has an error that none of the known effects explains.",
    "located": "Simulation and machine disagree.",
    "ambiguous": "These recordings cannot distinguish the remaining candidate effects.",
    "insufficient_excitation": "These recordings are not sufficient to identify what the simulation lacks, if anything.",
}
_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")


@dataclass(frozen=True)
class Agreement:
    """Error of a signal in that held-out recording in which it is the largest, relative to its noise floor, with the repair.

    Args:
        recording: empty where all recordings count together: forces at measured motion, static poses.
        before, after: RMSE without and with the repair [SI].
        noise_floor: RMSE of the true model in that recording.
        floor_source: how the noise of the signal is known.
        motion: standard deviation of the signal in the held-out recordings; of a point, of its coordinates together.
        moved: whether the axis moved in any recording; of a point, whether any axis did.
        unit: SI unit.
    """

    signal: str
    recording: str
    before: float
    after: float
    noise_floor: float
    floor_source: FloorSource
    motion: float
    moved: bool
    unit: str

    @property
    def floors(self) -> float:
        """The error with the repair in noise floors."""
        if self.noise_floor > 0.0:
            return self.after / self.noise_floor
        return math.inf if self.after > 0.0 else 0.0

    @property
    def differs(self) -> bool:
        """Whether the error exceeds what sensor noise explains, or is not a number."""
        return not self.floors <= AGREES

    @property
    def is_away(self) -> bool:
        """Whether the simulation does not follow the machine at all."""
        return not self.after <= max(AWAY * self.motion, AWAY_FLOORS * self.noise_floor)

    @property
    def open(self) -> str:
        """Why agreement says nothing here; empty if it does."""
        if not self.moved:
            return f"{self.signal} does not move"
        if self.floor_source == "unknown" or self.noise_floor > LARGEST_FLOOR * self.motion:
            return f"the noise of {self.signal} is not known: state it under [noise] in machine.toml"
        return ""


def verdict_of(named: bool, tied: bool, unnamed: bool, lacking: bool, agreement: Sequence[Agreement]) -> Verdict:
    """The verdict.

    Args:
        unnamed: a stage has an error that no effect explains.
        lacking: a stage is above its noise floor, and the recordings do not excite every effect there.
        agreement: of all measured signals; none where the errors on held-out recordings are missing.
    """
    if named or tied:
        return "named" if named else "ambiguous"
    if unnamed:
        return "unnamed"
    if lacking:
        return "insufficient_excitation"
    if any(item.moved and (item.differs or item.open) for item in agreement):
        return "unnamed"
    return "no_gap" if agreement and all(item.moved for item in agreement) else "insufficient_excitation"


def headline(verdict: str, effects: int, agreement: Sequence[Agreement] = (), disagrees: bool = True) -> str:
    """The verdict in words, with the largest error that remains; a simulation that does not follow the machine comes first.

    Args:
        effects: number of named effects.
        disagrees: a stage is above its noise floor.
    """
    found = HEADLINES.get(verdict, verdict)
    if verdict == "named":
        count = _COUNTS[effects] if effects < len(_COUNTS) else str(effects)
        found = f"{count} effect{' is' if effects == 1 else 's are'} missing from the simulation."
    worst = max((item for item in agreement if item.differs), key=_size, default=None)
    if worst is None:
        open_ = "" if disagrees else next((item.open for item in agreement if item.open), "")
        return f"What can be compared agrees to within sensor noise, but {open_}." if open_ else found
    error = quantity(worst.after, worst.unit) if math.isfinite(worst.after) else "without end"
    if worst.is_away:
        sizes = f"{error}, and moves by {quantity(worst.motion, worst.unit)} (RMS)"
        return f"The simulation does not follow the machine: {worst.signal} is off by {sizes}. {found}"
    with_them = "With the repair, " if verdict == "named" else ""
    text = f"{with_them}{worst.signal} is off by {error}, {ratio(worst.floors)} its noise floor."
    return f"{found} {text[0].upper()}{text[1:]}" if with_them else f"{found} {text}"


def _size(item: Agreement) -> tuple[bool, float]:
    return item.is_away, item.floors if math.isfinite(item.floors) else math.inf
