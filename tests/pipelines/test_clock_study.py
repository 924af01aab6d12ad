"""The study of clocks counts right: truth is what it says, mishaps happen, and what must be refused is."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

PIPELINES = str(Path(__file__).parents[2] / "pipelines")


@pytest.fixture(scope="module")
def study() -> Iterator[dict[str, ModuleType]]:
    """The study and its parts, found as the pipeline finds them."""
    import importlib

    sys.path.insert(0, PIPELINES)
    try:
        yield {name: importlib.import_module(name) for name in ("clock_study", "clock_simulation", "clock_peers")}
    finally:
        sys.path.remove(PIPELINES)


@pytest.mark.parametrize("kind", ["plain", "gaps", "jitter", "outliers"])
def test_the_truth_of_a_simulated_recording_is_its_truth(study: dict[str, ModuleType], kind: str) -> None:
    made = study["clock_simulation"].simulated(120.0, 0.5, kind, 1, noise=0.0)
    machine, other = (
        next(c for c in made.clocks.channels if (c.domain, c.signal) == (d, "slew.joint")) for d in ("machine", "mocap")
    )
    at = (machine.stamps - machine.stamps[0]) * 1e-9
    known = ~np.isnan(other.values) & (made.machine_s < at[-1])
    measured = np.isfinite(machine.values)
    difference = other.values[known] - np.interp(made.machine_s[known], at[measured], machine.values[measured])
    assert np.median(np.abs(difference)) < 5e-3
    rate = np.polyfit(made.stream_s, made.machine_s, 1)[0]
    assert 1e6 * (rate - 1.0) == pytest.approx(made.skew_ppm, abs=0.5)
    assert (np.isnan(other.values).any(), np.abs(difference).max() > 0.5) == (kind == "gaps", kind == "outliers")


def test_a_reset_is_in_the_stamps_or_in_the_motion(study: dict[str, ModuleType]) -> None:
    pieces = {study["clock_simulation"].simulated(30.0, 1.0, "reset", seed).pieces for seed in range(12)}
    assert pieces == {1, 2}


def test_one_recording_and_its_row(study: dict[str, ModuleType]) -> None:
    outcome = study["clock_study"].recovered(60.0, 1.0, "plain", 0)
    assert outcome.refused == ""
    assert abs(outcome.mid_ms) < 0.5
    row = study["clock_study"].cell([outcome, study["clock_study"].Outcome(60.0, 1.0, "plain", "two lags (0.9)")])
    assert (row["recordings"], row["refused"], row["reasons"]) == (2, 1, ["two lags"])
    assert row["mid_ms"] == pytest.approx(abs(outcome.mid_ms))


def test_what_must_be_refused_is(study: dict[str, ModuleType]) -> None:
    for case in study["clock_study"].MUST_REFUSE:
        row = study["clock_study"].refusals(case, 1)
        assert row["missed"] == 0, case
        assert row["reasons"], case


def test_the_usual_ways_are_not_worse_than_they_are(study: dict[str, ModuleType]) -> None:
    """The sub-sample peak finds mid-log, least squares both, and ours is at least as good."""
    rows = {row["way"]: row for row in study["clock_peers"].peer_rows(7, 2)}
    assert rows["integer-lag correlation"]["mid_ms"] < 6.0
    assert rows["sub-sample peak"]["mid_ms"] < 1.0
    squares = rows["least squares, offset + skew"]
    assert squares["end_ms"] < 0.3
    assert rows["`sysid`"]["end_ms"] < 1.3 * squares["end_ms"]
    assert rows["`sysid`"]["gaps_mid_ms"] < squares["gaps_mid_ms"]


def test_the_picture_has_a_line_a_motion_and_mishap(study: dict[str, ModuleType]) -> None:
    rows = [
        {"seconds": t, "hertz": h, "kind": k, "end_ms": 1.0 / t, "skew_ppm": 300.0 / t}
        for t in (30.0, 120.0)
        for h in study["clock_study"].MOTIONS
        for k in ("plain", "gaps")
    ]
    text = study["clock_study"].curves(rows)
    assert text.count("<polyline") == 16 + 4  # and the legend
    assert text.count('class="dashed"') == 8
    assert "nan" not in text
