"""The clocks on the page: each record with its interval and what the motions still differ by."""

from __future__ import annotations

from sysid.datasets import Dataset
from sysid.datasets.clocks.records import align
from sysid.datasets.clocks.residual import clock_residuals
from sysid.reports import ReportInputs, build_report
from sysid.reports.sections import quality
from tests.datasets.test_clock_resets import set_clock
from tests.datasets.test_clock_residual import stored


def test_every_piece_of_a_stream_is_shown_with_its_pictures(crane: Dataset) -> None:
    recording, _ = set_clock(60.0, 30.0, 1.7)
    inputs = ReportInputs(crane, clocks=clock_residuals(stored(recording), align([recording])))
    values = quality.clocks(inputs)
    assert values is not None
    assert [len(record["pictures"]) for record in values["records"]] == [3, 3]
    assert "s its clock was set by +1." in values["records"][1]["reason"]
    text = build_report(inputs)
    assert text.count("mocap.csv of take") == 2
    assert "offset correction of every 2 s" in text


def test_without_raw_channels_the_section_is_left_out(crane: Dataset) -> None:
    assert quality.clocks(ReportInputs(crane)) is None
