"""The half-width within which a clock offset is not an effect."""

from __future__ import annotations

from dataclasses import replace

import pytest
from plant_data import CAPTURE, dataset_of, nominal

from sysid.datasets.recording import ClockRecord, Dataset
from sysid.gap.prepare.clocks import open_offset


def record(
    recording: str, half: float, applied: bool = True, residual: float = 1.0, stream: str = "raw/capture.csv"
) -> ClockRecord:
    return ClockRecord(recording, stream, 0.2, 0.0, (0.2 - half, 0.2 + half), (-5.0, 5.0), residual, ("boom.joint",), applied)


def dataset(*records: ClockRecord, stream_hz: float = 120.0) -> Dataset:
    figures = {"run-1": {"raw/capture.csv/boom.joint": {"rate_hz": stream_hz, "clock": "mocap"}}}
    return replace(dataset_of(nominal(streams=CAPTURE), 2.0), streams=CAPTURE, clocks=records, quality={"streams": figures})


def test_two_standard_errors_and_half_a_sample() -> None:
    known = dataset(record("run-1", 1.96e-3), record("run-2", 1.96e-3))
    assert open_offset(known, "capture") == pytest.approx(2e-3 + 0.005)


def test_recordings_count_by_their_mean_square() -> None:
    known = dataset(record("run-1", 0.98e-3), record("run-2", 3.92e-3))
    assert open_offset(known, "capture") == pytest.approx(2.0 * ((0.5e-3**2 + 2e-3**2) / 2.0) ** 0.5 + 0.005)


@pytest.mark.parametrize(
    "own",
    [
        (),
        (record("run-1", 9e-3, applied=False),),
        (record("run-1", 9e-3, residual=float("nan")),),
        (record("run-1", 9e-3, stream="raw/other.csv"),),
    ],
    ids=["no alignment", "not applied", "static poses", "another stream"],
)
def test_without_an_alignment_on_motion_half_a_sample_is_open(own: tuple[ClockRecord, ...]) -> None:
    assert open_offset(dataset(*own), "capture") == pytest.approx(0.005)


def test_a_slow_stream_has_long_samples() -> None:
    assert open_offset(dataset(stream_hz=20.0), "capture") == pytest.approx(0.025)
