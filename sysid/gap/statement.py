"""What a gap result states: the verdict and its sentence, from the errors on held-out recordings.

Console, report, pages, JSON and Rerun recording take both from here, so that no two of them can differ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from sysid.display import quantity, ratio

Verdict = Literal["named", "no_gap", "unnamed", "ambiguous", "insufficient_excitation"]
#: How a noise floor is known: from the data sheet; from readings at rest that are repeats; from a second sensor; from the
#: sensor's samples, above the bandwidth of the motion; not from anything but the error itself.
FloorSource = Literal["stated", "rest", "two_sensors", "above_bandwidth", "unknown"]

#: A signal agrees with the machine if its error is within this multiple of its noise floor in every held-out recording.
AGREES = 1.5
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
    def worst(self) -> float:
        """The larger of both errors: a simulation agrees as it is, and with the repair."""
        return self.after if not self.before > self.after else self.before

    @property
    def differs(self) -> bool:
        """Whether an error exceeds what sensor noise explains, or is not a number."""
        return not self.floors(self.worst) <= AGREES

    @property
    def remains(self) -> bool:
        """Whether the error with the repair does."""
        return not self.floors(self.after) <= AGREES

    def floors(self, error: float) -> float:
        """An error in noise floors."""
        if self.noise_floor > 0.0:
            return error / self.noise_floor
        return math.inf if error > 0.0 else 0.0

    def is_away(self, error: float) -> bool:
        """Whether a simulation with this error does not follow the machine at all."""
        return not error <= max(AWAY * self.motion, AWAY_FLOORS * self.noise_floor)

    @property
    def at_rest(self) -> bool:
        """Whether the machine moves too little here for its noise, which is known apart from the motion."""
        small = self.noise_floor > LARGEST_FLOOR * self.motion
        return not self.moved or (small and self.floor_source in ("stated", "rest", "two_sensors"))

    @property
    def open(self) -> str:
        """Why agreement says nothing here; empty if it does."""
        if not self.moved:
            return f"{self.signal} does not move"
        if self.at_rest:
            sizes = f"{quantity(self.motion, self.unit)} (RMS), at a noise floor of {quantity(self.noise_floor, self.unit)}"
            return f"{self.signal} moves by only {sizes}, in the held-out recordings"
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
    if any(item.moved and (item.differs or (item.open and not item.at_rest)) for item in agreement):
        return "unnamed"
    return "no_gap" if agreement and not any(item.open for item in agreement) else "insufficient_excitation"


def headline(verdict: str, effects: int, agreement: Sequence[Agreement] = (), disagrees: bool = True) -> str:
    """The verdict in words, with the largest error that remains; a simulation that does not follow the machine comes first.

    Args:
        effects: number of named effects.
        disagrees: a stage is above its noise floor.
    """
    found, repaired = HEADLINES.get(verdict, verdict), verdict == "named"
    if repaired:
        count = _COUNTS[effects] if effects < len(_COUNTS) else str(effects)
        found = f"{count} effect{' is' if effects == 1 else 's are'} missing from the simulation."
    errors = [(item, item.after if repaired else item.worst) for item in agreement]
    beyond = [(item, error) for item, error in errors if not item.floors(error) <= AGREES]
    if not beyond:
        open_ = "" if disagrees else next((item.open for item in agreement if item.open), "")
        return f"What can be compared agrees to within sensor noise, but {open_}." if open_ else found
    item, error = max(beyond, key=lambda pair: (pair[0].is_away(pair[1]), _sized(pair[0].floors(pair[1]))))
    size = quantity(error, item.unit) if math.isfinite(error) else "without end"
    size += f" in {item.recording}" if item.recording else ""
    if item.is_away(error):
        sizes = f"{size}, and moves by {quantity(item.motion, item.unit)} (RMS)"
        return f"The simulation does not follow the machine: {item.signal} is off by {sizes}. {found}"
    if verdict == "unnamed" and not any(each.remains for each in agreement):
        found = "The simulation has an error that values without a name explain."
    text = (
        f"{'With the repair, ' if repaired else ''}{item.signal} is off by {size}, {ratio(item.floors(error))} its noise floor."
    )
    return f"{found} {text}"


def _sized(floors: float) -> float:
    return floors if math.isfinite(floors) else math.inf
