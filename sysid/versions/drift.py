"""Test for drift: errors of a network on new recordings against those on its own held-out ones.

First, rows outside of the fitted ranges are counted and excluded. On the others an output has drifted if its RMSE is
significantly larger than on the held-out rows, and more than 10 % larger than on the worst recording of its own dataset
(recordings differ in difficulty, which the significance test does not include). Significance is computed by a block bootstrap
(:mod:`sysid.validate.metrics`) of both sides, because errors of neighbouring rows are correlated, with Holm's correction over
the outputs (Scandinavian Journal of Statistics 6 (1979)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Kind, Recording
from sysid.errors import ExcitationError
from sysid.files import plain
from sysid.names import uncut_name
from sysid.networks import Model
from sysid.networks.split import RowRange, SignalRows, gather, measures, segments
from sysid.networks.uncertainty import within
from sysid.validate.metrics import bootstrap_means
from sysid.versions.outputs import OutputMap, output_maps

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Verdict = Literal["fits", "beyond its ranges", "drifted", "not comparable"]

#: A range is reported if a larger share of rows lies outside.
OUTSIDE_SHARE = 0.01
#: Smallest ratio of errors that counts as drift.
GROWN = 1.1
#: Family-wise significance level over all outputs.
LEVEL = 0.05
DRAWS = 2000
#: Fewest rows of either side for a comparison.
MIN_ROWS = 20


@dataclass(frozen=True)
class InputDrift:
    """One input: its fitted range and the range of the new rows.

    Args:
        outside: share of the new rows beyond the fitted range and 2 % of its width.
    """

    signal: str
    unit: str
    rows: Kind
    fitted: tuple[float, float]
    found: tuple[float, float]
    outside: float


@dataclass(frozen=True)
class OutputDrift:
    """One output on rows of one kind, inside the fitted ranges.

    Args:
        inside, outside: number of new rows inside and outside of the ranges of the inputs.
        own_rmse, rmse: on its own held-out rows and on the new ones, in ``unit``; NaN if there are too few.
        own_worst: largest RMSE on a recording of its own dataset.
        ratio95: 95 % interval of ``rmse / own_rmse``.
        p_value: of a ratio above 1.
        verdict: after Holm's correction over all outputs.
    """

    output: str
    unit: str
    rows: Kind
    inside: int
    outside: int
    own_rmse: float
    own_worst: float
    rmse: float
    ratio95: tuple[float, float]
    p_value: float
    verdict: Verdict

    @property
    def ratio(self) -> float:
        return self.rmse / self.own_rmse if self.own_rmse > 0.0 else math.nan


@dataclass(frozen=True)
class DriftReport:
    """A version against a new dataset.

    Args:
        recordings: those compared.
        known: those that are also in the version's own dataset, left out.
    """

    model: str
    own: str
    dataset: str
    recordings: tuple[str, ...]
    known: tuple[str, ...]
    inputs: tuple[InputDrift, ...]
    outputs: tuple[OutputDrift, ...]

    @property
    def verdict(self) -> Verdict:
        """The worst of all outputs and inputs."""
        if any(entry.verdict == "drifted" for entry in self.outputs):
            return "drifted"
        if any(entry.outside > OUTSIDE_SHARE for entry in self.inputs):
            return "beyond its ranges"
        return "fits" if any(entry.verdict == "fits" for entry in self.outputs) else "not comparable"

    def to_json(self) -> dict[str, Any]:
        """Plain values (NaN becomes null)."""
        values = {"verdict": self.verdict, **asdict(self)}
        for entry, output in zip(values["outputs"], self.outputs, strict=True):
            entry["ratio"] = output.ratio
        result: dict[str, Any] = plain(values)
        return result


def drift_of(model: Model, own: Dataset, new: Dataset, name: str = "", seed: int = 0) -> DriftReport:
    """Compare the errors of a network on a new dataset with those on the held-out rows of the one it was fitted on.

    Args:
        own: the dataset version that the network was fitted on.
        new: all rows are used, except recordings that are also in ``own``.

    Raises:
        ExcitationError: no recording of ``new`` is new and measures what the network predicts.
    """
    known = tuple(recording.name for recording in new.recordings if _held(recording, new, own))
    fresh = [recording for recording in new.recordings if recording.name not in known]
    inputs: dict[tuple[str, Kind], InputDrift] = {}
    outputs, used = [], list[str]()
    for answer in output_maps(model):
        signals = (*answer.inputs, answer.output)
        kinds: tuple[Kind, ...] = ("motion", "poses")
        for kind in kinds:
            parts = [RowRange(r, 0, len(r)) for r in fresh if r.kind == kind and _measured(r, signals)]
            if not parts or (answer.run is not None and kind == "poses"):
                continue
            rows = gather(parts, signals)
            used += [part.recording.name for part in parts]
            inside = _inside(answer, rows)
            for column, signal in enumerate(answer.inputs):
                inputs.setdefault((signal, kind), _input(answer, column, rows, kind))
            outputs.append(_output(answer, kind, rows, inside, new, own, seed))
    if not outputs:
        found = f"none of its {len(new.recordings)} recordings is new to it and measures what it predicts"
        known_text = f" ({', '.join(known)} known)" if known else ""
        expected = "at least one"
        raise ExcitationError(f"drift of {name or 'a network'} on {new.reference}", found + known_text, expected)
    recordings = tuple(dict.fromkeys(used))
    return DriftReport(name, own.reference, new.reference, recordings, known, tuple(inputs.values()), _corrected(outputs))


def _output(
    answer: OutputMap, kind: Kind, rows: SignalRows, inside: Mask, fresh: Dataset, own: Dataset, seed: int
) -> OutputDrift:
    squares = _squares(answer, rows, fresh)
    new = squares[inside & np.isfinite(squares)]
    before, worst = _own_errors(answer, kind, own)
    counts = (int(inside.sum()), int((~inside).sum()))
    if min(len(new), len(before)) < MIN_ROWS:
        rmse, own_rmse = (float(np.sqrt(part.mean())) if len(part) else math.nan for part in (new, before))
        nothing = (math.nan, math.nan)
        return OutputDrift(
            answer.output, answer.unit, kind, *counts, own_rmse, worst, rmse, nothing, math.nan, "not comparable"
        )
    least = 5 if kind == "motion" else 1  # poses are independent
    means = [bootstrap_means(part, seed + number, DRAWS, least) for number, part in enumerate((before, new))]
    ratios = np.sqrt(means[1] / np.maximum(means[0], 1e-300))
    low, high = np.percentile(ratios, [2.5, 97.5])
    return OutputDrift(
        output=answer.output,
        unit=answer.unit,
        rows=kind,
        inside=counts[0],
        outside=counts[1],
        own_rmse=float(np.sqrt(before.mean())),
        own_worst=worst,
        rmse=float(np.sqrt(new.mean())),
        ratio95=(float(low), float(high)),
        p_value=float((np.sum(ratios <= 1.0) + 1) / (DRAWS + 1)),
        verdict="fits",
    )


def _corrected(outputs: Sequence[OutputDrift]) -> tuple[OutputDrift, ...]:
    """Holm's step-down test: sets the verdict of drifted outputs."""
    compared = sorted((entry for entry in outputs if entry.verdict != "not comparable"), key=lambda entry: entry.p_value)
    grown = set[int]()
    for number, entry in enumerate(compared):
        if entry.p_value > LEVEL / (len(compared) - number):
            break
        if entry.rmse > GROWN * max(entry.own_rmse, entry.own_worst):
            grown.add(id(entry))
    return tuple(replace(entry, verdict="drifted") if id(entry) in grown else entry for entry in outputs)


def _own_errors(answer: OutputMap, kind: Kind, own: Dataset) -> tuple[Array, float]:
    """Squared errors on the version's own held-out rows, and its largest RMSE on a recording of its own dataset."""
    signals = (*answer.inputs, answer.output)
    if not measures(own, signals, kind):
        return np.zeros(0), math.nan
    found = []
    for recording in own.of_kind(kind):
        if _measured(recording, signals):
            rows = gather([RowRange(recording, 0, len(recording))], signals)
            errors = _squares(answer, rows, own)[_inside(answer, rows)]
            errors = errors[np.isfinite(errors)]
            found += [float(np.sqrt(errors.mean()))] if len(errors) >= MIN_ROWS else []
    rows = gather(segments(own, "held_out", signals, kind), signals)
    squares = _squares(answer, rows, own)[_inside(answer, rows)]
    return squares[np.isfinite(squares)], max(found, default=math.nan)


def _squares(answer: OutputMap, rows: SignalRows, dataset: Dataset) -> Array:
    """Squared errors, (n,); NaN where a network with history predicts nothing."""
    if answer.run is None:
        return np.asarray((answer.predict(rows.values[:, :-1]) - rows.values[:, -1]) ** 2)
    predicted = np.full(len(rows), np.nan)
    for name in np.unique(rows.recording):
        mine = rows.recording == name
        predicted[mine] = answer.run(dataset.recording(str(name)))[rows.row[mine]]
    return np.asarray((predicted - rows.values[:, -1]) ** 2)


def _inside(answer: OutputMap, rows: SignalRows) -> Mask:
    return within(rows.values[:, :-1], answer.low, answer.high)


def _input(answer: OutputMap, column: int, rows: SignalRows, kind: Kind) -> InputDrift:
    low, high = float(answer.low[column]), float(answer.high[column])
    values = rows.values[:, column]
    outside = float(np.mean(~within(values[:, None], answer.low[column : column + 1], answer.high[column : column + 1])))
    found = (float(values.min()), float(values.max()))
    return InputDrift(answer.inputs[column], answer.units[column], kind, (low, high), found, outside)


def _measured(recording: Recording, signals: Sequence[str]) -> bool:
    return bool(np.all([np.isfinite(recording.values(signal)) for signal in signals], axis=0).any())


def _held(recording: Recording, new: Dataset, own: Dataset) -> bool:
    """Whether ``own`` has this recording too: from the same raw files, or with equal values."""
    files = _raw(new, recording)
    for other in own.recordings:
        if files and files == _raw(own, other):
            return True
        same = len(recording) == len(other) and set(recording.signals) == set(other.signals)
        if same and all(
            np.array_equal(recording.values(signal), other.values(signal), equal_nan=True) for signal in other.signals
        ):
            return True
    return False


def _raw(dataset: Dataset, recording: Recording) -> frozenset[str]:
    """Digests of the raw files in the folder of a recording."""
    folders = {recording.name, uncut_name(recording.name)}
    return frozenset(source.sha256 for source in dataset.sources if source.path.rpartition("/")[0] in folders)
