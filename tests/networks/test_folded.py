"""A geometry that no longer changes says the same as the one that may, on any chain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.machine import load_machine
from sysid.machine.kinematics import Kinematics
from sysid.networks.geometry import Geometry

MACHINE = Path(__file__).parents[2] / "datasets" / "autolog" / "machine.toml"


def crane() -> Kinematics:
    kinematics = load_machine(MACHINE).kinematics()
    assert kinematics is not None
    return kinematics


def oblique(slides: tuple[int, ...]) -> Kinematics:
    """The crane's chain with axes that point anywhere, and other joints that slide."""
    kinematics, rng = crane(), np.random.default_rng(3)
    chain = []
    for joint in kinematics.chain:
        number = kinematics.actuated.index(joint.name) if joint.name in kinematics.actuated else None
        axis = rng.normal(size=3)
        kind = joint.kind if number is None else ("prismatic" if number in slides else "revolute")
        chain.append(replace(joint, axis=axis / np.linalg.norm(axis), kind=kind))
    return replace(kinematics, chain=tuple(chain))


@pytest.mark.parametrize(
    "kinematics", [crane(), oblique(()), oblique((0, 2)), oblique((0, 1, 2, 3))], ids=["crane", "turns", "mixed", "slides"]
)
def test_folded_is_the_same_chain(kinematics: Kinematics) -> None:
    geometry, rng = Geometry(kinematics), np.random.default_rng(0)
    values = rng.normal(0.0, 0.3, len(geometry.parameters)) * ~geometry.elastic
    folded = geometry.folded(values)
    assert folded is not None
    for count in (0, 1, 50):
        q = rng.uniform(-3.0, 3.0, (count, len(kinematics.actuated)))
        np.testing.assert_allclose(folded.tip(q), geometry.tip(q, values), rtol=0.0, atol=1e-12)
    nominal = geometry.folded(0.0 * values)
    assert nominal is not None
    np.testing.assert_allclose(nominal.tip(q), kinematics.tip_position(q), rtol=0.0, atol=1e-12)


def test_missing_joint_values_give_no_prediction() -> None:
    geometry = Geometry(crane())
    q = np.array([[0.1, 0.2, np.nan, 0.3], [0.1, 0.2, 0.3, 0.4]])
    folded = geometry.folded(np.zeros(len(geometry.parameters)))
    assert folded is not None
    np.testing.assert_array_equal(np.isnan(folded.tip(q)).any(axis=1), [True, False])
