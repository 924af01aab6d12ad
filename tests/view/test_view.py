"""The Rerun file, read back with Rerun's own reader."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import rerun.blueprint as rrb
from sample_crane import sample_gap, sample_traces

from sysid.datasets.recording import Dataset
from sysid.errors import StoreError
from sysid.machine import Kinematics, machine_from_files
from sysid.view import write_rerun
from sysid.view.drawing import NAME_M, link_entity, link_shapes
from sysid.view.layout import arm_points, camera, screen
from sysid.view.recording import largest_moment, worst_moments


class Written:
    """Everything in a recording: entity → its chunks as tables."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        reader = RrdReader(str(path))
        self.blueprints = len(list(reader.blueprints()))
        self.tables: dict[str, list[Any]] = {}
        for chunk in reader.stream().to_chunks():
            self.tables.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())

    def column(self, entity: str, component: str) -> tuple[np.ndarray, list[Any]]:
        """``(time [s], values)`` of one component over time."""
        for batch in self.tables[entity]:
            names = [name for name in batch.schema.names if name.endswith(component)]
            if names and "time" in batch.schema.names:
                return batch.column("time").cast("int64").to_numpy() * 1e-9, batch.column(names[0]).to_pylist()
        raise AssertionError(f"{entity} has no {component}: {[b.schema.names for b in self.tables[entity]]}")


@pytest.fixture(scope="module")
def written(crane: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Written:
    traces = sample_traces(crane)
    path = tmp_path_factory.mktemp("view") / "deep" / "crane.rrd"
    assert write_rerun(path, crane, "manual-04", {"before": traces.before, "after": traces.after}, sample_gap(crane)) == path
    assert [file.name for file in path.parent.iterdir()] == ["crane.rrd"]
    return Written(path)


def test_every_link_moves_in_every_version(written: Written, crane: Dataset) -> None:
    kinematics = crane.machine.kinematics()
    assert kinematics is not None
    for version in ("measured", "before", "after"):
        for link in ("base", *(joint.child for joint in kinematics.chain)):
            assert f"/machine/{version}/links/{link}" in written.tables


@pytest.mark.parametrize("name", ["ee", "a/b", "x y", '"><b>', "links", "🙂", "a\\"])
def test_a_link_may_have_any_name(name: str, crane: Dataset, tmp_path: Path) -> None:
    """It is one entity, and none of those of the points."""
    files = dict(crane.machine.files())
    files |= {file: text.replace('"stick"', quoteattr(name)) for file, text in files.items() if file.endswith(".urdf")}
    dataset = replace(crane, machine=machine_from_files(files, "test"))
    written = Written(write_rerun(tmp_path / "a.rrd", dataset, "manual-04", {}))
    kinematics = dataset.machine.kinematics()
    assert kinematics is not None
    moved = {entity for entity in written.tables if entity.startswith("/machine/measured/links/") and "/shape-" not in entity}
    assert moved == {f"/{link_entity('machine/measured', link)}" for link in kinematics.link_poses(np.zeros((1, 4)))}
    points = written.tables["/machine/measured/ee"]
    assert not any("Transform3D" in column for batch in points for column in batch.schema.names)


def test_link_poses_are_those_of_the_kinematics(written: Written, crane: Dataset) -> None:
    recording = crane.recording("manual-04")
    kinematics = crane.machine.kinematics()
    assert kinematics is not None
    joints = np.column_stack([recording.values(f"{axis}.joint") for axis in crane.machine.axis_names])
    pose = kinematics.link_poses(joints)["stick"]
    time, places = written.column("/machine/measured/links/stick", "translation")
    np.testing.assert_allclose(time, recording.values("time"), atol=1e-9)
    np.testing.assert_allclose([place[0] for place in places], pose[:, :3, 3], atol=1e-6)
    _, turns = written.column("/machine/measured/links/stick", "quaternion")
    x, y, z, w = np.array([turn[0] for turn in turns]).T
    first_axis = np.column_stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])
    np.testing.assert_allclose(first_axis, pose[:, :3, 0], atol=1e-5)


def test_curves_are_in_display_units_and_gaps_stay_gaps(written: Written, crane: Dataset) -> None:
    recording = crane.recording("manual-04")
    _, values = written.column("/signals/boom.joint/measured", "scalars")
    np.testing.assert_allclose([value[0] for value in values], np.degrees(recording.values("boom.joint")), rtol=1e-9)
    time, _ = written.column("/signals/ee.x/measured", "scalars")
    known = np.isfinite(recording.values("ee.x"))
    assert 0 < known.sum() < len(known), "the sample has a drop-out"
    np.testing.assert_allclose(time, recording.values("time")[known], atol=1e-9)


def test_commands_are_there_once_and_predictions_beside_measurements(written: Written) -> None:
    curves = {path for path in written.tables if path.startswith("/signals/")}
    assert {"/signals/boom.command/measured", "/signals/boom.cylinder/before", "/signals/tool.z/after"} <= curves
    assert "/signals/boom.command/before" not in curves
    assert written.blueprints == 1


def test_a_machine_without_geometry_has_its_curves(crane: Dataset, tmp_path: Path) -> None:
    bare = replace(crane, machine=replace(crane.machine, urdf_text=None, tip=None))
    written = Written(write_rerun(tmp_path / "bare.rrd", bare, "manual-01", {}))
    assert not any(path.startswith("/machine/") for path in written.tables)
    assert "/signals/boom.cylinder/measured" in written.tables


def test_unknown_recording_suggests_the_nearest(crane: Dataset, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"no recording 'manual-4'.*'manual-04'\?"):
        write_rerun(tmp_path / "x.rrd", crane, "manual-4", {})
    assert list(tmp_path.iterdir()) == [], "nothing half-written"


def test_shapes_come_from_the_urdf_and_bars_fill_in(crane: Dataset) -> None:
    kinematics = crane.machine.kinematics()
    assert isinstance(kinematics, Kinematics)
    shapes = link_shapes(crane.machine.urdf_text or "", kinematics)
    assert shapes["boom"][0].kind == "box"
    assert shapes["boom"][0].size == (0.576, 0.06, 0.07)
    assert shapes["column"][0].size[0] == 0.05
    stripped = (crane.machine.urdf_text or "").replace("visual>", "other>")
    bars = link_shapes(stripped, kinematics)
    assert bars["boom"][0].kind == "bar"
    assert math.hypot(*bars["boom"][0].size) == pytest.approx(0.576)


def drawn(written: Written, entity: str, component: str) -> list[Any]:
    """A static component of an entity."""
    for batch in written.tables[entity]:
        for name in batch.schema.names:
            if name.endswith(component):
                return list(batch.column(name).to_pylist()[0])
    raise AssertionError(f"{entity} has no {component}")


def test_informative_maps_are_line_charts_with_words_and_units(written: Written) -> None:
    path = "/maps/boom.cylinder/speed_error/boom.command"
    (strip,) = drawn(written, f"{path}/before", "strips")
    heights = np.array(strip)[:, 1]
    values = np.array([1.2, 1.1, 0.0, -1.9, -2.0])  # mm/s, in the order of the bins
    scale = (heights[-1] - heights[0]) / (values[-1] - values[0])
    np.testing.assert_allclose(np.diff(heights), scale * np.diff(values), rtol=1e-4)
    assert heights[0] < heights[-1], "larger errors are drawn higher"
    assert drawn(written, f"{path}/words", "labels") == ["boom.command", "speed error of boom.cylinder [mm/s]"]
    assert "0" in drawn(written, f"{path}/ticks", "labels")
    assert f"{path}/after" in written.tables
    assert "/maps/boom.cylinder/error/direction_of_boom/before" in written.tables
    assert "/maps/boom.cylinder/error/direction_of_boom/after" not in written.tables, "nothing is known of it after the repair"


def test_errors_run_beside_their_signals_with_a_mark_at_the_worst_moment(written: Written, crane: Dataset) -> None:
    traces = sample_traces(crane)
    error = np.degrees((traces.before["boom.joint"] - traces.measured["boom.joint"]).to_numpy())
    _, values = written.column("/errors/boom.joint/before", "scalars")
    np.testing.assert_allclose([value[0] for value in values], error[np.isfinite(error)], rtol=1e-6, atol=1e-9)
    time, values = written.column("/errors/boom.joint/before/largest", "scalars")
    row = int(np.nanargmax(np.abs(error)))
    assert time[0] == pytest.approx(traces.measured["time"].iloc[row])
    assert values[0][0] == pytest.approx(error[row])
    assert "/moments" in written.tables


def test_the_findings_are_text_with_values_and_units(written: Written) -> None:
    text = "".join(drawn(written, "/findings", "text"))
    assert "**Backlash** on slew: width 0.603° (0.596 to 0.611°)" in text
    assert "| boom.cylinder |" in text


def test_every_version_is_named_in_space_above_the_one_before(written: Written) -> None:
    heights = []
    for version in ("measured", "before", "after"):
        assert drawn(written, f"/machine/{version}/legend", "labels") == [version]
        _, names = written.column(f"/machine/{version}/legend", "positions")
        _, points = written.column(f"/machine/{version}/tool", "positions")
        heights.append(names[0][0][2] - points[0][0][2])
    np.testing.assert_allclose(heights, [NAME_M, 2.0 * NAME_M, 3.0 * NAME_M], atol=1e-5)


def test_the_camera_looks_at_the_arm_and_sees_all_of_it(crane: Dataset) -> None:
    table = crane.recording("manual-04").table
    eye = camera(crane.machine, table)
    target, position = (np.array(batch.as_arrow_array().to_pylist()[0]) for batch in (eye.look_target, eye.position))
    points = arm_points(crane.machine, table)
    tool = table[["tool.x", "tool.y", "tool.z"]].to_numpy()
    assert np.linalg.norm(points - tool[np.isfinite(tool).all(axis=1)][0], axis=1).min() < 0.05, "the tool is one of them"
    towards = (target - position) / np.linalg.norm(target - position)
    rays = points - position
    angles = np.degrees(np.arccos((rays @ towards) / np.linalg.norm(rays, axis=1)))
    assert np.quantile(angles, 0.98) < 32.0, "within the view"
    assert np.quantile(angles, 0.98) > 12.0, "and no small part of it"
    assert position[2] > target[2]


def test_the_seconds_around_the_largest_error_of_the_tool_are_played(crane: Dataset) -> None:
    traces = sample_traces(crane)
    tables = {"measured": traces.measured, "before": traces.before, "after": traces.after}
    largest = max((moment for moment in worst_moments(tables) if moment.version == "before" and "tool" in moment.signal),
                  key=lambda moment: abs(moment.error))  # fmt: skip
    assert largest_moment(worst_moments(tables), tables) == largest.time
    panel = screen(rrb.TextLogView(), "time", largest.time).time_panel
    assert panel.time_selection.min.value == int(1e9 * max(0.0, largest.time - 4.0))
    assert panel.time_selection.max.value == int(1e9 * (largest.time + 1.0))
    assert (panel.loop_mode, panel.play_state) == ("selection", "playing")
