"""Markers without a rigid body: single markers as points, sets of them as bodies, whatever is missing or confused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sysid.datasets.frames.bodies import joints_and_points
from sysid.datasets.frames.rigid import body_poses, rigid_body, with_marker_sets
from sysid.datasets.recipe import FramePose, PointMap, StreamMap, load_recipe
from sysid.errors import InputError, SettingsError
from sysid.logs import Stream
from sysid.machine import Machine, load_machine

Array = npt.NDArray[np.float64]
SHAPE = np.array([[-0.19, 0.05, 0.03], [-0.05, 0.06, 0.04], [-0.13, -0.06, 0.05], [-0.07, -0.05, -0.02]])


@pytest.fixture(scope="module")
def crane() -> Machine:
    return load_machine(Path(__file__).parents[2] / "datasets/autolog/machine.toml")


def motion(seed: int, frames: int = 200) -> tuple[Array, Array, Array]:
    """Rotations, positions and markers of a body that tumbles."""
    rng = np.random.default_rng(seed)
    time = 0.01 * np.arange(frames)[:, None]
    turns, position = (
        size * np.sin(rng.uniform(0.3, 2.0, 3) * time + rng.uniform(0.0, 6.0, 3)) for size in (rng.uniform(0.5, 2.0), 0.3)
    )
    rotation = Rotation.from_rotvec(turns).as_matrix()
    return rotation, position, np.einsum("nij,mj->nmi", rotation, SHAPE) + position[:, None]


def own_frame(shape: Array) -> Array:
    """Axes of the body's frame (columns) in the frame that ``shape`` is given in."""
    x = (shape[1] - shape[0]) / np.linalg.norm(shape[1] - shape[0])
    z = np.cross(x, shape[2] - shape[0])
    z /= np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def streams(markers: Array, *names: str) -> list[Stream]:
    stamps = {"capture": np.arange(len(markers)) * 10_000_000}
    labels = names or tuple(f"m{i}" for i in range(markers.shape[1]))
    return [
        Stream(label, Path("trial.c3d"), stamps, {axis: markers[:, i, k] for k, axis in enumerate("xyz")})
        for i, label in enumerate(labels)
    ]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_the_pose_is_that_of_the_body(seed: int) -> None:
    rotation, position, markers = motion(seed)
    found, origin, error = rigid_body(markers)
    np.testing.assert_allclose(found, rotation @ own_frame(SHAPE), atol=1e-9)
    np.testing.assert_allclose(origin, position + rotation @ SHAPE.mean(axis=0), atol=1e-9)
    assert error.max() < 1e-9


def test_a_missing_marker_changes_nothing_and_two_are_too_many() -> None:
    _, _, markers = motion(1)
    whole = rigid_body(markers)
    markers[50:60, 2] = np.nan
    markers[55, 1] = np.nan
    rotation, position, error = rigid_body(markers)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(position[:, 0])), [55])
    assert np.isnan(rotation[55]).all()
    assert np.isnan(error[55])
    rows = np.arange(len(markers)) != 55
    np.testing.assert_allclose(rotation[rows], whole[0][rows], atol=1e-9)
    np.testing.assert_allclose(position[rows], whole[1][rows], atol=1e-9)


def test_confused_markers_show_in_the_error_and_do_not_spoil_the_shape() -> None:
    _, _, markers = motion(2)
    clean = rigid_body(markers)
    markers[:40, [0, 2]] = markers[:40, [2, 0]]
    rotation, _, error = rigid_body(markers)
    assert error[:40].min() > 0.01
    np.testing.assert_allclose(error[40:], 0.0, atol=1e-9)
    np.testing.assert_allclose(rotation[40:], clean[0][40:], atol=1e-9)


def test_noise_is_averaged_over_the_markers() -> None:
    _, _, markers = motion(3, frames=2000)
    clean = rigid_body(markers)
    noisy = rigid_body(markers + 1e-4 * np.random.default_rng(0).standard_normal(markers.shape))
    assert np.sqrt(np.mean((noisy[1] - clean[1]) ** 2)) == pytest.approx(1e-4 / np.sqrt(4), rel=0.1)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: m * np.array([1.0, 0.0, 0.0]), "the first three markers are collinear"),
        (lambda m: np.where(np.arange(4)[None, :, None] == 1, np.nan, m), "no frame in which all markers are visible"),
    ],
)
def test_sets_that_fix_no_pose_are_refused(change: object, reason: str) -> None:
    markers = np.tile(SHAPE, (20, 1, 1))
    mapping = StreamMap(files="*.c3d", marker_sets={"body": ("m0", "m1", "m2", "m3")})
    with pytest.raises(InputError, match=rf"trial\.c3d: body: {reason}; expected at least three markers"):
        with_marker_sets(streams(change(markers)), mapping)  # type: ignore[operator]


def test_a_set_becomes_a_body_like_an_exported_one(crane: Machine) -> None:
    rotation, position, markers = motion(4)
    names = tuple(f"tip:{i}" for i in range(4))
    mapping = StreamMap(
        files="*.c3d",
        frame=FramePose(translation=(1.0, 2.0, 3.0)),
        marker_sets={"tip": names},
        points={"ee": PointMap(body="tip", at=(0.1, 0.0, 0.2)), "tool": PointMap(marker="tip:3")},
    )
    found = with_marker_sets(streams(markers, *names), mapping)
    assert [stream.name for stream in found] == [*names, "tip"]
    np.testing.assert_allclose(body_poses(found[-1], FramePose())[:, :3, :3], rotation @ own_frame(SHAPE), atol=1e-9)
    points, flags = joints_and_points(found, mapping, {}, crane)
    signals = {item.signal: item.values for item in points}
    at = position + rotation @ (SHAPE.mean(axis=0) + own_frame(SHAPE) @ [0.1, 0.0, 0.2])
    for point, expected in (("ee", at), ("tool", markers[:, 3])):
        seen = np.column_stack([signals[f"{point}.{axis}"] for axis in "xyz"])
        np.testing.assert_allclose(seen - expected, np.tile([1.0, 2.0, 3.0], (len(seen), 1)), atol=1e-9)
    assert flags == ()


def test_a_marker_that_jumps_is_set_to_missing(crane: Machine) -> None:
    _, _, markers = motion(5)
    markers[100:110, 0] += 0.4
    mapping = StreamMap(files="*.c3d", points={"ee": PointMap(marker="m0")})
    points, (dropped,) = joints_and_points(streams(markers), mapping, {}, crane)
    assert [item.signal for item in points] == ["ee.x", "ee.y", "ee.z"]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(points[0].values)), np.arange(100, 110))
    assert (dropped.body, dropped.frames) == ("m0", 10)
    (flag,) = points[1].flags
    assert (flag.signal, flag.kind, flag.samples) == ("ee.y", "marker_swap", 10)
    assert "m0: jumped further than a machine can move; set to missing" in flag.text


def test_markers_with_stamps_of_their_own_make_no_body() -> None:
    mapping = StreamMap(files="*.c3d", marker_sets={"body": ("m0", "m1", "m2")})
    found = list(streams(np.tile(SHAPE, (5, 1, 1))))
    found[1] = replace(found[1], stamps={name: stamps + 1 for name, stamps in found[1].stamps.items()})
    with pytest.raises(InputError, match=r"body: marker 'm1' has other stamps than 'm0'; expected markers of one capture"):
        with_marker_sets(found, mapping)


def test_an_unknown_marker_is_named() -> None:
    mapping = StreamMap(files="*.c3d", marker_sets={"body": ("m0", "m1", "mm2")})
    with pytest.raises(SettingsError, match=r"marker_sets\.body: no marker 'mm2'; expected 'm2'\?"):
        with_marker_sets(streams(np.tile(SHAPE, (3, 1, 1))), mapping)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("points = {ee = {}}", r"points\.ee: neither a body nor a marker; expected one of them"),
        ('points = {ee = {body = "b", marker = "m"}}', r"points\.ee: both a body and a marker"),
        ('points = {ee = {marker = "m", at = [0.0, 0.0, 0.1]}}', r"`at` with a marker; expected a body"),
        ('marker_sets = {b = ["m1", "m2"]}', r"marker_sets\.b: markers \['m1', 'm2'\]; expected at least three"),
        ('marker_sets = {b = ["m1", "m2", "m1"]}', "at least three different ones"),
        ('dbc = "../other.dbc"', r"path '\.\./other\.dbc' leaves the folder"),
        ('dbc = "machin.dbc"', r"dbc: no file 'machin\.dbc'; expected 'machine\.dbc'\?"),
    ],
)
def test_mistakes_in_the_recipe_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "machine.dbc").touch()
    path = tmp_path / "recipe.toml"
    path.write_text(f'schema = 1\n[[streams]]\nfiles = "*"\n{text}\n')
    with pytest.raises(SettingsError, match=message):
        load_recipe(path)


def test_the_database_is_found_beside_the_recipe(tmp_path: Path) -> None:
    (tmp_path / "machine.dbc").touch()
    path = tmp_path / "recipe.toml"
    path.write_text('schema = 1\n[[streams]]\nfiles = "*.blf"\ndbc = "machine.dbc"\n')
    assert load_recipe(path).streams[0].dbc == str((tmp_path / "machine.dbc").resolve())
