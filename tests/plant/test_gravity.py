"""Gravity loads are the slope of the potential energy, and the fast sine is a sine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from plant_data import arm, loaded_arm, slide
from weight import slopes

from sysid.datasets.recording import Recording
from sysid.machine import Machine, load_machine, machine_from_files
from sysid.plant import gravity_load
from sysid.plant.trig import LARGEST, sincos
from sysid.signals import axis_signal
from sysid.testing import probe_machine

Array = npt.NDArray[np.float64]
AUTOLOG = Path(__file__).parents[2] / "datasets" / "autolog"


def urdf_of(machine: Machine) -> str:
    (text,) = (text for name, text in machine.files().items() if name.endswith(".urdf"))
    return text


def at(machine: Machine, joints: Array) -> Recording:
    """Poses (n, A), each by itself."""
    table = {axis_signal(name, "joint"): joints[:, i] for i, name in enumerate(machine.axis_names)}
    return Recording("poses", pd.DataFrame({"time": np.arange(len(joints)) / 100.0, **table}), 100.0, "poses")


def expected(machine: Machine, joints: Array) -> Array:
    urdf, names = urdf_of(machine), [str(axis.joint) for axis in machine.axes]
    assert machine.tip is not None
    return np.array([slopes(urdf, dict(zip(names, map(float, row), strict=True)), machine.tip) for row in joints])


def oblique() -> Machine:
    """The probe with masses, frames that are turned, axes that are aligned with nothing, a slide that is steep."""
    files = probe_machine().files()
    urdf = files["probe.urdf"]
    changes = {
        '<origin xyz="0.05 0 0"/><axis xyz="0 -1 0"/>': '<origin xyz="0.05 0.02 0.1" rpy="0.3 -0.2 0.5"/>'
        '<axis xyz="0.36 -0.48 0.8"/>',
        '<origin xyz="0.6 0 0"/><axis xyz="1 0 0"/>': '<origin xyz="0.6 0 0" rpy="0 -0.7 0.2"/><axis xyz="0 0 1"/>',
        '<origin xyz="0.3 0 0"/><axis xyz="0 -1 0"/>': '<origin xyz="0.3 0 0" rpy="1.1 0 0"/><axis xyz="1 0 0"/>',
        '<link name="column"/>': '<link name="column"><inertial><origin xyz="0.3 0 0"/><mass value="9"/></inertial></link>',
        '<link name="arm"/>': '<link name="arm"><inertial><origin xyz="0.3 -0.1 0.05"/><mass value="4"/></inertial></link>',
        '<link name="hand"/>': '<link name="hand"><inertial><origin xyz="0.1 0.2 0"/><mass value="2"/></inertial></link>',
        '<link name="tip"/>': '<link name="tip"><inertial><mass value="1.5"/></inertial></link>',
    }
    for before, after in changes.items():
        assert urdf.count(before) == 1
        urdf = urdf.replace(before, after)
    return machine_from_files({**files, "probe.urdf": urdf}, "oblique")


MACHINES = {
    "probe, one kilogram at the tip": probe_machine(),
    "oblique axes": oblique(),
    "arm, one kilogram at the tip": arm(),
    "arm with masses": loaded_arm(),
    "shipped crane with a hanging gripper": load_machine(AUTOLOG / "machine.toml"),
}


@pytest.mark.parametrize("name", MACHINES)
def test_load_is_the_slope_of_the_energy(name: str) -> None:
    machine = MACHINES[name]
    joints = np.random.default_rng(4).uniform(-1.2, 1.2, (6, len(machine.axes)))
    found, slope = gravity_load(machine, at(machine, joints)), expected(machine, joints)
    assert np.abs(slope).max() > 3.0
    np.testing.assert_allclose(found, slope, rtol=0.0, atol=1e-5 * np.abs(slope).max())


def test_a_load_opposes_lifting() -> None:
    """Stretched out, 1 kg at 0.85 m: positive about the axis whose positive motion lifts it, nothing about an upright one."""
    machine = arm()
    (row,) = gravity_load(machine, at(machine, np.zeros((1, 3))))
    assert row == pytest.approx([0.0, 9.80665 * 0.85, 9.80665 * 0.25])
    (raised,) = gravity_load(machine, at(machine, np.array([[0.7, np.pi / 2, 0.0]])))
    assert np.abs(raised).max() < 1e-9


def test_gaps_of_a_motion_are_bridged_and_those_of_poses_are_not() -> None:
    machine = arm()
    joints = np.column_stack([np.zeros(50), np.linspace(0.0, 0.5, 50), np.zeros(50)])
    whole = gravity_load(machine, replace(at(machine, joints), kind="motion"))
    joints[20:30, 1] = np.nan
    motion = gravity_load(machine, replace(at(machine, joints), kind="motion"))
    np.testing.assert_allclose(motion, whole, atol=1e-12)
    poses = gravity_load(machine, at(machine, joints))
    assert np.isnan(poses[20:30]).all()
    np.testing.assert_allclose(poses[:20], whole[:20], atol=1e-12)


def test_no_load_without_geometry_or_where_a_joint_is_never_measured() -> None:
    assert not gravity_load(slide(), at(slide(), np.zeros((5, 1)))).any()
    joints = np.zeros((5, 3))
    joints[:, 2] = np.nan
    assert not gravity_load(arm(), at(arm(), joints)).any()


# -- sine and cosine -------------------------------------------------------------------------------------------------

pair = njit(lambda x: sincos(x))


@settings(deadline=None)  # the first call compiles
@given(st.floats(-LARGEST, LARGEST) | st.floats(-7.0, 7.0))
def test_sine_and_cosine(x: float) -> None:
    s, c = pair(x)
    assert abs(s - np.sin(x)) < 3e-16
    assert abs(c - np.cos(x)) < 3e-16


def test_sine_and_cosine_where_the_quarters_meet() -> None:
    for k in range(-40, 41):
        for x in (k * np.pi / 4, np.nextafter(k * np.pi / 4, -np.inf), np.nextafter(k * np.pi / 4, np.inf)):
            assert np.allclose(pair(float(x)), (np.sin(x), np.cos(x)), rtol=0.0, atol=3e-16)


@pytest.mark.parametrize("x", [1e6, -3e8, 1e300])
def test_beyond_the_reduction_the_library_is_asked(x: float) -> None:
    assert pair(x) == pytest.approx((np.sin(x), np.cos(x)), abs=1e-15)


def test_what_is_no_angle_has_no_sine() -> None:
    assert np.isnan(pair(float("nan"))).all()
