"""The data of the replay: positions of the machine's points in each frame."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest
from sample_crane import sample_gap, sample_unnamed

from sysid.datasets.recording import Dataset
from sysid.reports.sections.traces import RATE, REPLAY_WINDOW, largest_error_signals, replay, worst_moment


def points(packed: dict[str, str], frames: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed["bdata"]), "<f4").reshape(frames, -1, 3)


def test_the_frames_are_the_machine_around_its_largest_error(crane: Dataset) -> None:
    gap = sample_gap(crane)
    found = replay(gap, crane.machine, repaired=True)
    assert found is not None
    moment = worst_moment(gap.traces, largest_error_signals(gap)[0], "before")
    assert moment is not None
    assert (found["recording"], found["at"]) == (moment.recording, moment.time)
    time = np.frombuffer(base64.b64decode(found["time"]["bdata"]), "<f4")
    assert len(time) == found["frames"] == 1 + int(REPLAY_WINDOW * RATE)
    assert time[0] <= moment.time <= time[-1]
    np.testing.assert_allclose(np.diff(time), 1.0 / RATE, atol=0.011)
    for name, packed in found["versions"].items():
        own = points(packed, found["frames"])
        table = getattr(gap.traces[0], name)
        row = int(np.argmin(np.abs(table["time"].to_numpy() - time[10])))
        np.testing.assert_allclose(own[10, -2], table.loc[row, ["ee.x", "ee.y", "ee.z"]].to_numpy(dtype=float), atol=1e-5)
        lengths = np.linalg.norm(np.diff(own[:, :-2], axis=1), axis=2)  # links are rigid; the telescope is the last
        assert np.nanmax(np.ptp(lengths[:, :-2], axis=0)) < 1e-5


def test_without_repair_only_the_simulation_before_is_shown(crane: Dataset) -> None:
    found = replay(sample_unnamed(crane), crane.machine, repaired=False)
    assert found is not None
    assert list(found["versions"]) == ["measured", "before"]


@pytest.mark.parametrize("lack", ["urdf", "joint", "traces"])
def test_nothing_is_shown_where_the_postures_are_not_known(crane: Dataset, lack: str) -> None:
    gap, machine = sample_gap(crane), crane.machine
    if lack == "urdf":
        machine = replace(machine, urdf_text=None)
    elif lack == "joint":
        gap = replace(gap, traces=tuple(replace(t, measured=t.measured.drop(columns="boom.joint")) for t in gap.traces))
    else:
        gap = replace(gap, traces=())
    assert replay(gap, machine, repaired=True) is None
