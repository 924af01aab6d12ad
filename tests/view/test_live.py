"""The world shown in Rerun while it moves: every state arrives, and as many as were promised."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from crane_data import LINKAGES, dataset, motion
from rerun_file import curves

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import StoreError
from sysid.plant import Plant, free_run, nominal_plant
from sysid.view.live import CAMERA_HZ, STATE_HZ, show_live

pytest.importorskip("pybullet", reason="PyBullet has no build for this Python")


def steered(seconds: float = 2.0) -> Recording:
    source = motion("run-1", seconds, 1)
    time = source.values("time")
    commands = {f"{axis}.command": 0.3 * np.sin(2.0 * time) for axis in ("slew", "boom", "stick", "telescope")}
    return replace(source, table=source.table.assign(**commands))


@pytest.fixture
def crane() -> tuple[Dataset, Plant]:
    data = replace(dataset((steered(),), {}), units={"boom.joint": "rad", "slew.joint": "rad"})
    return data, nominal_plant(data.machine, LINKAGES)


def test_states_arrive_in_the_file(crane: tuple[Dataset, Plant], tmp_path: Path) -> None:
    path = tmp_path / "deep" / "live.rrd"
    shown = show_live(crane[0], "run-1", crane[1], path)
    assert shown == 2.0 * STATE_HZ
    assert [file.name for file in path.parent.iterdir()] == ["live.rrd"]
    entities = curves(path)
    expected = free_run(crane[1], crane[0].recordings[0])
    for signal in ("boom.joint", "slew.joint"):
        time, values = entities[f"/signals/{signal}/world"]
        rows = np.rint(time * 100.0).astype(int)
        assert len(rows) == shown
        np.testing.assert_allclose(values, np.degrees(expected[signal].to_numpy()[rows]), atol=1e-6)
    assert {"/machine/world/links/boom", "/machine/world/tool", "/signals/boom.cylinder/measured"} <= set(entities)
    assert len(entities["/camera"][0]) == 2.0 * CAMERA_HZ


def test_mistakes(crane: tuple[Dataset, Plant], tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="run-2"):
        show_live(crane[0], "run-2", crane[1], tmp_path / "x.rrd")
    assert not list(tmp_path.iterdir())
