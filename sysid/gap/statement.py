"""What a gap result states in words: its verdict, where responses differ, and what it leaves open.

Console, report, pages, JSON and Rerun recording take their sentences from here, so that no two of them can differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from sysid.datasets.quality.responses import AxisResponse, Direction, responses_in
from sysid.datasets.recording import Recording
from sysid.display import interval, quantity, ratio, signal_name
from sysid.machine import Convention, Machine

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
#: Speeds at full command that differ by less than this share are alike: they are medians over a few commands.
ALIKE = 0.1

HEADLINES = {
    "no_gap": "The simulation agrees with the machine to within sensor noise.",
    "unnamed": "The simulation has an error that none of the known effects explains.",
    "located": "Simulation and machine disagree.",
    "ambiguous": "These recordings cannot distinguish the remaining candidate effects.",
    "insufficient_excitation": "These recordings are not sufficient to identify what the simulation lacks, if anything.",
}
_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")


# -- verdict ------------------------------------------------------------------------------------------------------------


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
            return f"{signal_name(self.signal)} does not move"
        if self.at_rest:
            sizes = f"{quantity(self.motion, self.unit)} (RMS), at a noise floor of {quantity(self.noise_floor, self.unit)}"
            return f"{signal_name(self.signal)} moves by only {sizes}, in the held-out recordings"
        if self.floor_source == "unknown" or self.noise_floor > LARGEST_FLOOR * self.motion:
            return f"the noise of {signal_name(self.signal)} is not known: state it under [noise] in machine.toml"
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
    item, error = max(beyond, key=lambda pair: _severity(*pair))
    name = signal_name(item.signal)
    size = quantity(error, item.unit) if math.isfinite(error) else "without end"
    size += f" in {item.recording}" if item.recording else ""
    if item.is_away(error):
        sizes = f"{size}, and moves by {quantity(item.motion, item.unit)} (RMS)"
        return f"The simulation does not follow the machine: {name} is off by {sizes}. {found}"
    if verdict == "unnamed" and not any(each.remains for each in agreement):
        found = "The simulation has an error that values without a name explain."
    text = f"{'With the repair, ' if repaired else ''}{name} is off by {size}, {ratio(item.floors(error))} its noise floor."
    return f"{found} {text}"


def _severity(item: Agreement, error: float) -> tuple[bool, float]:
    floors = item.floors(error)
    return item.is_away(error), floors if math.isfinite(floors) else math.inf


# -- responses ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ResponseDifference:
    """One figure of an axis in which recordings and simulation differ, both read without a model.

    Args:
        quantity: ``delay`` between command and motion [s], the command at which motion ``begins``, speed at ``full`` command.
        side: direction of the command; empty for a delay.
        recorded, simulated: lowest and highest value that each shows; NaN above where no command moves it.
        unit: SI unit.
    """

    axis: str
    quantity: Literal["delay", "begins", "full"]
    side: Literal["", "positive", "negative"]
    recorded: tuple[float, float]
    simulated: tuple[float, float]
    unit: str


def response_differences(
    recordings: Sequence[Recording], runs: Sequence[pd.DataFrame], machine: Machine, units: Mapping[str, str]
) -> tuple[ResponseDifference, ...]:
    """The differences between ``recordings`` of motion and their simulated ``runs`` (columns = signals, same rows)."""
    simulated = []
    for recording, run in zip(recordings, runs, strict=True):
        driven = [axis.driven for axis in machine.axes if axis.driven in run.columns and axis.driven in recording.signals]
        values = {signal: run[signal].where(recording.table[signal].notna().to_numpy()).to_numpy() for signal in driven}
        simulated.append(Recording(recording.name, recording.table.assign(**values), recording.rate_hz))
    found = {response.axis: response for response in responses_in(simulated, machine, units)}
    measured = responses_in(recordings, machine, units)
    row = 1.0 / min((recording.rate_hz for recording in recordings), default=1.0)
    return tuple(item for response in measured for item in _between(response, found[response.axis], row))


def _between(recorded: AxisResponse, simulated: AxisResponse, row: float) -> Iterator[ResponseDifference]:
    """The differences of one axis; ``row``: longest period of the recordings [s]."""
    axis = recorded.axis
    if _apart(recorded.delay95, simulated.delay95) and abs(recorded.delay - simulated.delay) > row:
        yield ResponseDifference(axis, "delay", "", recorded.delay95, simulated.delay95, "s")
    sides: tuple[tuple[Literal["positive", "negative"], Direction | None, Direction | None], ...] = (
        ("positive", recorded.positive, simulated.positive), ("negative", recorded.negative, simulated.negative)
    )  # fmt: skip
    for side, one, other in sides:
        if one is None or other is None:
            continue
        if _apart(one.begins, other.begins):
            yield ResponseDifference(axis, "begins", side, one.begins, other.begins, "1")
        if _apart(one.full95, other.full95) and abs(one.full - other.full) > ALIKE * max(one.full, other.full):
            yield ResponseDifference(axis, "full", side, one.full95, other.full95, f"{recorded.unit}/s")


def _apart(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two ranges have nothing in common; false where either is unknown."""
    return one[0] > other[1] or other[0] > one[1]


def response_sentences(differences: Sequence[ResponseDifference], repaired: bool) -> list[str]:
    """What the recordings show without a model and the simulation does not, one sentence an axis."""
    whose = "the repaired simulation" if repaired else "the simulation"
    by_axis: dict[str, list[str]] = {}
    for item in differences:
        by_axis.setdefault(item.axis, []).append(_response_text(item))
    return [f"Without a model {axis} differs from {whose}: {'; '.join(texts)}." for axis, texts in by_axis.items()]


def _response_text(item: ResponseDifference) -> str:
    recorded, simulated = (_range_text(item, values) for values in (item.recorded, item.simulated))
    if item.quantity == "delay":
        return f"it follows its command after {recorded}, simulated {simulated}"
    if item.quantity == "begins":
        return f"{item.side} commands move it {recorded}, simulated {simulated}"
    return f"its speed at full {item.side} command is {recorded}, simulated {simulated}"


def _range_text(item: ResponseDifference, values: tuple[float, float]) -> str:
    if item.quantity == "begins":
        if math.isnan(values[1]):
            return f"not at all up to {values[0]:.2g}"
        return f"from less than {values[1]:.2g}" if values[0] == 0.0 else f"from {values[0]:.2g} to {values[1]:.2g}"
    return quantity(values[0], item.unit) if values[0] == values[1] else interval(*values, item.unit)


# -- what a result leaves open -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CommandOrder:
    """The order of command and sample in the rows of the recordings (:data:`sysid.machine.Convention`).

    Args:
        stream: of the commands; empty where it is not known.
        source: ``stated`` in the machine's description, or ``estimated`` from the motion.
        open_s: length of a dead time that an estimate leaves open [s].
    """

    stream: str
    convention: Convention
    source: Literal["stated", "estimated"]
    open_s: float


def order_sentence(order: CommandOrder | None) -> str:
    """The estimated order of command and sample, and what it leaves open; empty where it is stated or without influence."""
    if order is None or order.source == "stated":
        return ""
    first = {
        "read_before_written": "the sample of a row is read before its command acts",
        "written_before_read": "the command of a row has acted for a whole period when its sample is read",
    }[order.convention]
    row = quantity(order.open_s, "s")
    return (
        f"Order of command and sample, as the motion shows it: {first}. A dead time up to one row ({row}) gets no name, and a "
        "named one may be one row longer. If you know the order, state it in machine.toml: "
        f'convention = "{order.convention}".'
    )


@dataclass(frozen=True)
class Missing:
    """A part of a result that follows the decision and could not be computed, and why (:mod:`sysid.gap.following`)."""

    part: str
    reason: str


def missing_sentences(missing: Sequence[Missing]) -> list[str]:
    """What could not be computed after the effects were decided."""
    return [
        f"Missing from this result: {item.part}. {item.reason[:1].upper()}{item.reason[1:].rstrip('.')}." for item in missing
    ]


def left_out_sentence(left_out: Sequence[str]) -> str:
    """What the machine's description contains and the simulation does not; empty where that is nothing."""
    if not left_out:
        return ""
    return (
        f"The description of the machine also contains: {'; '.join(left_out)}. An effect that is found there may stand for it."
    )
