"""Torques of the links of an arm against the closed form of two links in a vertical plane."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from planar_arm import C2, I2, LENGTH, M1, M2, planar

pytest.importorskip("pinocchio")

from sysid.datasets.recording import Recording
from sysid.errors import SettingsError
from sysid.machine import KnownEffect, machine_from_files
from sysid.machine.kinematics import GRAVITY
from sysid.plant import compile_plant, nominal_plant
from sysid.plant.link_torque import link_torque
from sysid.plant.stepper import Stepper
from sysid.testing.probe import probe_arm

Array = npt.NDArray[np.float64]
RATE = 500.0


def motion(seconds: float = 4.0) -> tuple[Recording, Array, Array, Array]:
    t = np.arange(round(seconds * RATE)) / RATE
    sizes, rates = np.array([0.7, 0.9]), np.array([2.1, 3.3])
    q = sizes * np.sin(rates * t[:, None])
    v, a = sizes * rates * np.cos(rates * t[:, None]), -sizes * rates**2 * np.sin(rates * t[:, None])
    return Recording("m", pd.DataFrame({"time": t, "lift.joint": q[:, 0], "elbow.joint": q[:, 1]}), RATE), q, v, a


def torques(*effects: KnownEffect) -> Array:
    plant = nominal_plant(probe_arm())
    for effect in effects:
        plant = plant.with_effect(effect)
    model, (recording, *_) = compile_plant(plant), motion()
    return np.column_stack([link_torque(model, model.theta, recording, name).whole for name in ("lift", "elbow")])


def assert_close(found: Array, wanted: Array) -> None:
    """Away from the ends, where filters of the motion begin."""
    inner = slice(200, -200)
    np.testing.assert_allclose(found[inner], wanted[inner], atol=2e-3 * np.abs(wanted).max())


def test_links_of_the_urdf() -> None:
    _, q, v, a = motion()
    assert_close(torques(), planar(q, v, a, M1, M2, C2, I2))


def test_a_heavier_link_has_more_mass_moment_and_inertia() -> None:
    _, q, v, a = motion()
    found = torques(KnownEffect("link_mass_error", "elbow", {"ratio": 1.3}))
    assert_close(found, planar(q, v, a, M1, 1.3 * M2, C2, 1.3 * I2))


def test_a_payload_is_a_point_mass_in_the_frame_of_the_tip() -> None:
    _, q, v, a = motion()
    mass, at = 1.5, np.array([0.3 + 0.05, 0.03])  # the tip is 0.3 m from the elbow
    found = torques(KnownEffect("payload", "tool", {"mass": mass, "centre": [0.05, -0.02, 0.03]}))
    whole = M2 + mass
    centre = (M2 * C2 + mass * at) / whole
    inertia = I2 + M2 * float(np.sum((C2 - centre) ** 2)) + mass * float(np.sum((at - centre) ** 2))
    assert_close(found, planar(q, v, a, M1, whole, centre, inertia))


def test_adjusted_parameters_add_to_those_of_the_urdf() -> None:
    """Half a kilogram at the elbow's axis loads the lifting joint alone; a rotor resists its own joint."""
    _, q, _, a = motion()
    zero = {"first_moment": [0.0] * 3, "inertia": [0.0] * 6, "scale": 1.0}
    heavy = torques(KnownEffect("inertial_error", "elbow", {"mass": 0.5, "rotor": 0.0, **zero})) - torques()
    lifted = 0.5 * LENGTH * (LENGTH * a[:, 0] + GRAVITY * np.cos(q[:, 0]))
    assert_close(heavy, np.column_stack([lifted, 0.0 * lifted]))
    rotor = torques(KnownEffect("inertial_error", "elbow", {"mass": 0.0, "rotor": 0.2, **zero})) - torques()
    assert_close(rotor, np.column_stack([0.0 * a[:, 1], 0.2 * a[:, 1]]))
    scaled = torques(KnownEffect("inertial_error", "elbow", {"mass": 0.0, "rotor": 0.0, **zero, "scale": 0.9}))
    assert_close(scaled, torques() * [1.0, 0.9])


@pytest.mark.parametrize("width", [0.0, 0.8])
def test_friction_grows_with_the_torque_of_the_links(width: float) -> None:
    """Against the motion, without the inertia of the rotor; with the direction of smooth friction where that acts too."""
    recording, q, v, a = motion()
    coefficient, force = 0.15, 2.0
    plant = nominal_plant(probe_arm()).with_effect(KnownEffect("load_dependent_friction", "lift", {"coefficient": coefficient}))
    zero = {"mass": 0.0, "first_moment": [0.0] * 3, "inertia": [0.0] * 6, "scale": 1.0}
    plant = plant.with_effect(KnownEffect("inertial_error", "lift", {"rotor": 0.4, **zero}))
    if width:
        plant = plant.with_effect(KnownEffect("smooth_coulomb_friction", "lift", {"force": force, "width": width}))
    model, carried = compile_plant(plant), planar(q, v, a, M1, M2, C2, I2)[:, 0]
    found = link_torque(model, model.theta, recording, "lift")
    out = model.inverse(model.theta, "lift", q[:, 0], v[:, 0], a[:, 0], 1.0 / RATE, found.carried)
    direction = np.tanh(v[:, 0] / width) if width else np.sign(v[:, 0])
    assert_close(found.rotor, 0.4 * a[:, 0])
    assert_close(out, (coefficient * np.abs(carried) + (force if width else 0.0)) * direction)


def test_a_joint_that_is_not_measured_leaves_no_torque() -> None:
    recording = motion()[0]
    model = compile_plant(nominal_plant(probe_arm()))
    table = recording.table.assign(**{"elbow.joint": np.nan})
    assert not link_torque(model, model.theta, Recording("m", table, RATE), "lift").whole.any()


def test_an_arm_is_not_stepped() -> None:
    with pytest.raises(SettingsError, match="no forward dynamics"):
        Stepper(nominal_plant(probe_arm()), 100.0)


def test_inertia_of_a_rotor_may_be_unknown_but_not_that_of_everything_that_moves() -> None:
    text = 'schema = 1\nname = "m"\nrate_hz = 100\n[[axes]]\nname = "a"\nactuation = "force"\ndrives = "joint"\n'
    with pytest.raises(SettingsError, match="no inertia"):
        machine_from_files({"machine.toml": text}, "m")
