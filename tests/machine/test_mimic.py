"""Passive joints of a URDF: a palletiser whose parallel linkage keeps the wrist level."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from palletiser import JOINTS, SHOULDER, urdf

from sysid.errors import SettingsError
from sysid.machine.kinematics import Kinematics
from sysid.networks import Geometry, calibrate
from sysid.plant.layout import base_place, neutral_vector
from sysid.plant.machine_arrays import links_of
from sysid.plant.pose import loads

Array = npt.NDArray[np.float64]


def palletiser() -> Kinematics:
    return Kinematics.from_urdf(urdf(), JOINTS, "wrist_link")


def free() -> Kinematics:
    """The same with an axis for the leveller."""
    return Kinematics.from_urdf(urdf(""), ("slew", "shoulder", "elbow", "leveller", "wrist"), "wrist_link")


def followed(q: Array) -> Array:
    """Values of all joints: the leveller's follows the shoulder's."""
    return np.column_stack([q[:, :3], 0.2 - q[:, 1], q[:, 3]])


def taken(count: int) -> Array:
    return np.random.default_rng(0).uniform(-1.2, 1.2, (count, 4))


def plant_loads(kinematics: Kinematics, q: Array) -> Array:
    out, axes = np.empty_like(q), q.shape[1]
    loads(neutral_vector(axes).copy(), links_of(kinematics), base_place(axes), q, out)
    return out


def test_a_passive_joint_follows_its_master() -> None:
    q = taken(20)
    expected = free().tip_position(followed(q))
    np.testing.assert_allclose(palletiser().tip_position(q), expected, atol=1e-12)
    geometry = Geometry(palletiser())
    nothing = np.zeros(len(geometry.parameters))
    np.testing.assert_allclose(geometry.tip(q, nothing), expected, atol=1e-12)
    folded = geometry.folded(nothing)
    assert folded is not None
    np.testing.assert_allclose(folded.tip(q), expected, atol=1e-12)


def test_its_load_acts_on_the_master() -> None:
    """The work of the leveller's load is done by the shoulder's axis: dV/dq of the shoulder has both."""
    q = taken(20)
    every = plant_loads(free(), followed(q))
    expected = np.column_stack([every[:, 0], every[:, 1] - every[:, 3], every[:, 2], every[:, 4]])
    np.testing.assert_allclose(plant_loads(palletiser(), q), expected, atol=1e-10)
    geometry = Geometry(palletiser())
    own = geometry.loads(q, np.zeros(len(geometry.parameters)))
    axes = [number for number, moved in enumerate(geometry.chain) if not moved.passive]
    np.testing.assert_allclose(own[:, axes, 0], expected, atol=1e-10)


def test_it_may_follow_another_passive_joint() -> None:
    text = urdf(
        '<mimic joint="elbow" multiplier="2" offset="0.1"/>', '<mimic joint="shoulder" multiplier="-0.5" offset="0.3"/>'
    )
    found = Kinematics.from_urdf(text, ("slew", "shoulder", "wrist"), "wrist_link").drives["leveller"]
    assert (found.column, found.ratio, found.offset) == pytest.approx((1, -1.0, 0.7))


def test_slopes_of_a_passive_joint() -> None:
    geometry, q = Geometry(palletiser()), taken(5)
    values = geometry.priors * np.random.default_rng(1).standard_normal(len(geometry.priors))
    held = geometry.loads(q, values)
    steps = 1e-6 * geometry.priors[:, None] * np.eye(len(values))
    expected = [(geometry.points_at(q, values + s, held) - geometry.points_at(q, values - s, held)) / 2e-6 for s in steps]
    scaled = geometry.point_slopes(q, values, held) * geometry.priors
    np.testing.assert_allclose(scaled, np.stack(expected, axis=3), atol=1e-7)


def test_a_palletiser_is_calibrated() -> None:
    geometry, rng = Geometry(palletiser()), np.random.default_rng(2)
    keys = [parameter.key for parameter in geometry.parameters]
    values = np.zeros(len(keys))
    for key, value in {"leveller.offset": 0.01, "shoulder.compliance": 3e-5, "elbow.z": 0.003}.items():
        values[keys.index(key)] = value
    q = rng.uniform(-1.2, 1.2, (150, 4))
    tip = geometry.tip(q, values) + 2e-4 * rng.standard_normal((150, 3))
    found = calibrate(geometry, q, tip, np.full(4, np.nan), np.full(3, 2e-4))
    unseen = taken(100)
    assert np.sqrt(np.mean((found.predict(unseen) - geometry.tip(unseen, values)) ** 2)) < 1e-4
    elastic = {each.parameter.key: each.value for each in found.parameters if each.parameter.optional}
    assert elastic["shoulder.compliance"] == pytest.approx(3e-5, rel=0.1)


@pytest.mark.parametrize(
    ("leveller", "elbow", "message"),
    [
        ('<mimic joint="sholder"/>', "", r"joint 'leveller': mimic: unknown joint 'sholder'; .*shoulder"),
        ('<mimic joint="elbow"/>', '<mimic joint="leveller"/>', "mimic: a cycle: elbow → leveller → elbow"),
        ('<mimic joint="leveller"/>', "", "a cycle: leveller → leveller"),
        ("<mimic/>", "", "joint 'leveller': mimic: no joint"),
        ('<mimic joint="elbow" multiplier="x"/>', "", "multiplier"),
        ("", "", "'leveller' moves the tip but no axis names it"),
        (
            SHOULDER,
            '<mimic joint="shoulder"/>',
            r"joint 'elbow' of an axis is passive \(mimic\); expected an axis for 'shoulder'",
        ),
    ],
)
def test_a_wrong_mimic_is_refused(leveller: str, elbow: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Kinematics.from_urdf(urdf(leveller, elbow), JOINTS, "wrist_link")
