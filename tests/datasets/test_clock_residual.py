"""What aligned motions still differ by: a clock and a map that are wrong show where they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import ClockRecord
from sysid.datasets.clocks.records import RecordingClocks, align
from sysid.datasets.clocks.residual import clock_residuals
from tests.datasets.test_clock_resets import set_clock


def stored(recording: RecordingClocks) -> pd.DataFrame:
    """The raw channels as the store gives them."""
    return pd.concat(
        [
            pd.DataFrame(
                {
                    "recording": recording.name,
                    "source": c.source,
                    "domain": c.domain,
                    "signal": c.signal,
                    "stamp_ns": c.stamps,
                    "value": c.values,  # noqa: PD011
                }
            )
            for c in recording.channels
        ],
        ignore_index=True,
    )


@pytest.fixture(scope="module")
def aligned() -> tuple[pd.DataFrame, Sequence[ClockRecord]]:
    recording, _ = set_clock(90.0, 40.0, 1.7)
    return stored(recording), align([recording])


def test_a_right_record_leaves_noise(aligned: tuple[pd.DataFrame, Sequence[ClockRecord]]) -> None:
    channels, records = aligned
    first, second = clock_residuals(channels, records)
    assert first.times[-1] < 40.5 < second.times[-1], "each piece has its own"
    for found in (first, second):
        assert np.all(np.abs(found.shift) < 6.0 * found.error)
        assert np.abs(found.residual - 1.0).max() < 0.3
        (pair,) = found.pairs
        assert pair.name == "slew.joint~slew.joint"
        assert np.nanmax(np.abs(pair.mean)) < pair.noise


def test_a_wrong_skew_shows_over_time_and_a_wrong_offset_at_once(aligned: tuple[pd.DataFrame, Sequence[ClockRecord]]) -> None:
    channels, records = aligned
    wrong = [replace(record, skew_ppm=record.skew_ppm + 400.0, offset_s=record.offset_s) for record in records]
    second = clock_residuals(channels, wrong)[1]
    seconds = second.times - second.times[0]
    assert np.polyfit(seconds, second.shift, 1)[0] == pytest.approx(-400e-6, rel=0.1)
    shifted = clock_residuals(channels, [replace(records[0], offset_s=records[0].offset_s + 0.005), records[1]])[0]
    assert np.median(shifted.shift) == pytest.approx(-0.005, rel=0.1)


def test_records_that_were_not_estimated_from_motion_have_none(aligned: tuple[pd.DataFrame, Sequence[ClockRecord]]) -> None:
    channels, records = aligned
    refused = [replace(record, applied=False) for record in records]
    assert clock_residuals(channels, refused) == ()
