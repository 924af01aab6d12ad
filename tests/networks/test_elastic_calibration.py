"""Geometry and elasticity of an arm from one set of poses: recovery with both hidden, nothing hidden, ties, several markers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sysid.machine.kinematics import Kinematics
from sysid.networks import Geometry, calibrate
from sysid.networks.calibration import Calibration
from sysid.plant.layout import base_place, neutral_vector
from sysid.plant.machine_arrays import links_of
from sysid.plant.pose import loads

Array = npt.NDArray[np.float64]
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0")
ORIGINS = ("0 0 0.1", "0 0.1 0.2", "0 -0.05 0.5", "0 0.05 0.4", "0 0.06 0.05", "0 0 0.09")
MASSES = (6.0, 9.0, 5.0, 2.0, 1.0, 0.5)
NOISE = 2e-4
JOINTS, POINT = np.full(6, np.nan), np.full(3, NOISE)


def arm(masses: bool = True) -> Kinematics:
    """Six revolute joints; the weight of each link is in its middle."""
    parts = ['<robot name="arm"><link name="l0"/>']
    for k, (axis, origin, mass) in enumerate(zip(AXES, ORIGINS, MASSES, strict=True)):
        inertial = f'<inertial><origin xyz="0 0 0.2"/><mass value="{mass}"/></inertial>' if masses else ""
        parts.append(
            f'<link name="l{k + 1}">{inertial}</link><joint name="j{k + 1}" type="revolute"><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/><origin xyz="{origin}"/><axis xyz="{axis}"/><limit lower="-2" upper="2"/></joint>'
        )
    parts.append('<link name="tip"/><joint name="end" type="fixed"><parent link="l6"/><child link="tip"/>')
    parts.append('<origin xyz="0.02 0 0.08"/></joint></robot>')
    return Kinematics.from_urdf("".join(parts), tuple(f"j{k + 1}" for k in range(6)), "tip")


def values_of(geometry: Geometry, named: dict[str, float]) -> Array:
    keys = [parameter.key for parameter in geometry.parameters]
    values = np.zeros(len(keys))
    for key, value in named.items():
        values[keys.index(key)] = value
    return values


def measured(geometry: Geometry, values: Array, count: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, (count, 6))
    points = geometry.points(q, values)
    return q, points + NOISE * rng.standard_normal(points.shape)


def optional(found: Calibration) -> dict[str, float]:
    return {each.parameter.key: each.value for each in found.parameters if each.parameter.optional}


def held_out(found: Calibration, geometry: Geometry, values: Array) -> float:
    q = np.random.default_rng(99).uniform(-2.0, 2.0, (300, 6))
    return float(np.sqrt(((found.predict(q) - geometry.tip(q, values)) ** 2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def bent() -> tuple[Geometry, Array, Calibration]:
    """Zeros, a length, a tilt, the frame and two compliances hidden together."""
    geometry = Geometry(arm())
    hidden = {"j1.x": 0.01, "j1.ry": 0.01, "j3.offset": 0.012, "j3.z": 0.004, "j4.rx": -0.005}
    values = values_of(geometry, {**hidden, "j2.compliance": 6e-5, "j3.compliance": 9e-5})
    q, points = measured(geometry, values, 200, 0)
    return geometry, values, calibrate(geometry, q, points, JOINTS, POINT)


def test_loads_are_those_of_the_plant() -> None:
    geometry = Geometry(arm())
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 6))
    plant = np.empty((20, 6))
    loads(neutral_vector(6).copy(), links_of(geometry.kinematics), base_place(6), q, plant)
    own = geometry.loads(q, np.zeros(len(geometry.parameters)))[:, :, 0]
    np.testing.assert_allclose(own, plant, atol=1e-10)


def test_geometry_and_compliance_are_found_together(bent: tuple[Geometry, Array, Calibration]) -> None:
    geometry, values, found = bent
    assert set(optional(found)) == {"j2.compliance", "j3.compliance"}
    keys = [parameter.key for parameter in geometry.parameters]
    for each in found.parameters:
        if each.parameter.optional:
            assert each.value == pytest.approx(values[keys.index(each.parameter.key)], rel=0.05)
            assert each.support is not None
            assert each.support.gain > 20.0
    assert held_out(found, geometry, values) < NOISE


def test_compliance_is_not_a_scale(bent: tuple[Geometry, Array, Calibration]) -> None:
    """Without elastic parameters the same poses give wrong scales and larger errors: what the comparison has to prevent."""
    geometry, values, found = bent
    q, points = measured(geometry, values, 200, 0)
    rigid = calibrate(geometry, q, points, JOINTS, POINT, elastic=False)
    assert any(key.endswith(".scale") for key in optional(rigid))
    assert held_out(rigid, geometry, values) > 3.0 * held_out(found, geometry, values)
    assert rigid.noise > 1.5 * found.noise


@pytest.mark.parametrize("seed", range(4))
def test_a_rigid_arm_has_neither_compliance_nor_scale(seed: int) -> None:
    geometry = Geometry(arm())
    values = 0.1 * geometry.priors * np.random.default_rng(seed).standard_normal(len(geometry.priors)) * ~geometry.optional
    found = calibrate(geometry, *measured(geometry, values, 120, seed), JOINTS, POINT)
    assert optional(found) == {}


def test_a_scale_is_a_scale() -> None:
    geometry = Geometry(arm())
    values = values_of(geometry, {"j3.scale": 0.01, "j2.offset": 0.01})
    found = calibrate(geometry, *measured(geometry, values, 200, 3), JOINTS, POINT)
    assert set(optional(found)) == {"j3.scale"}
    assert optional(found)["j3.scale"] == pytest.approx(0.01, rel=0.02)


def test_a_base_that_tilts_to_one_side() -> None:
    """Lateral compliance across the slewing axis, about one direction of the base; a compliance of the next joint beside it."""
    geometry = Geometry(arm())
    values = values_of(geometry, {"j1.lateral_x": 4e-5, "j2.compliance": 6e-5, "j3.y": 0.003})
    found = calibrate(geometry, *measured(geometry, values, 200, 4), JOINTS, POINT)
    assert set(optional(found)) == {"j1.lateral_x", "j2.compliance"}
    assert optional(found)["j1.lateral_x"] == pytest.approx(4e-5, rel=0.05)
    assert optional(found)["j2.compliance"] == pytest.approx(6e-5, rel=0.05)
    assert held_out(found, geometry, values) < NOISE


def test_what_the_poses_do_not_determine_is_said() -> None:
    """Three parallel axes: their places along the axes are one number, and the poses of one elbow angle hide its zero."""
    geometry = Geometry(arm())
    q = np.random.default_rng(5).uniform(-2.0, 2.0, (150, 6))
    points = geometry.tip(q, np.zeros(len(geometry.parameters)))
    found = calibrate(geometry, q, points, JOINTS, POINT)
    groups = [{key for key, _ in combination} for combination in found.non_identifiable]
    assert {"j2.y", "j3.y", "j4.y"} <= set.union(*groups)
    status = {each.parameter.key: each.status for each in found.parameters}
    assert status["j3.y"] != "determined"
    assert status["j3.z"] == "determined"


def test_markers_are_placed_with_the_geometry() -> None:
    """Two markers, one of them on an earlier link and missing in half of the poses; their places are unknown."""
    geometry = Geometry(arm(), {"elbow": "l4", "hand": "l6"})
    hidden = {"elbow.x": 0.05, "elbow.y": -0.03, "hand.x": 0.06, "hand.z": 0.02, "j3.offset": 0.01, "j2.compliance": 8e-5}
    values = values_of(geometry, hidden)
    q, points = measured(geometry, values, 80, 6)
    points[::2, 1] = np.nan
    found = calibrate(geometry, q, points, JOINTS, np.full((3, 3), NOISE))
    calibrated = {each.parameter.key: each for each in found.parameters}
    assert optional(found)["j2.compliance"] == pytest.approx(8e-5, rel=0.05)
    for key in ("hand.x", "elbow.x"):
        assert calibrated[key].value == pytest.approx(hidden[key], abs=4.0 * calibrated[key].deviation)
    assert held_out(found, geometry, values) < 2.0 * NOISE


def test_a_frame_that_is_far_away_is_registered_first() -> None:
    from scipy.spatial.transform import Rotation

    geometry = Geometry(arm())
    values = values_of(geometry, {"j3.offset": 0.01, "j2.compliance": 8e-5})
    q, points = measured(geometry, values, 120, 7)
    turn, shift = Rotation.from_rotvec([0.0, 0.0, 2.0]), np.array([3.0, -1.0, 0.5])
    moved = turn.apply(points[:, 0]) + shift
    found = calibrate(geometry, q, moved, JOINTS, POINT)
    assert optional(found)["j2.compliance"] == pytest.approx(8e-5, rel=0.05)
    unseen = np.random.default_rng(8).uniform(-2.0, 2.0, (100, 6))
    expected = turn.apply(geometry.tip(unseen, values)) + shift
    assert np.sqrt(((found.predict(unseen) - expected) ** 2).sum(axis=1).mean()) < NOISE
