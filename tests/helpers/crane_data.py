"""A dataset of a crane whose linkages and kinematics are known: cylinder, joint and end effector with a little noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording, Role
from sysid.machine import Linkage, Machine, TriangleLinkage, machine_from_files

Array = npt.NDArray[np.float64]

URDF = """<robot name="crane">
  <link name="base"/><link name="column"/><link name="boom"/><link name="stick"/><link name="tip"/>
  <joint name="slew_joint" type="revolute"><parent link="base"/><child link="column"/>
    <origin xyz="0 0 0.285"/><axis xyz="0 0 1"/><limit lower="-2.6" upper="2.6"/></joint>
  <joint name="boom_joint" type="revolute"><parent link="column"/><child link="boom"/>
    <origin xyz="0 0 0"/><axis xyz="0 -1 0"/><limit lower="-0.43" upper="1.4"/></joint>
  <joint name="stick_joint" type="revolute"><parent link="boom"/><child link="stick"/>
    <origin xyz="0.576 0 0"/><axis xyz="0 -1 0"/><limit lower="-2.6" upper="-0.1"/></joint>
  <joint name="telescope_joint" type="prismatic"><parent link="stick"/><child link="tip"/>
    <origin xyz="0.4 0 0"/><axis xyz="1 0 0"/><limit lower="0" upper="0.25"/></joint>
</robot>
"""

MACHINE = """
schema = 1
name = "crane"
rate_hz = 100.0
urdf = "crane.urdf"
tip = "tip"
[noise]
"boom.cylinder" = 2e-5
"boom.joint" = 5e-4
"stick.cylinder" = 2e-5
"stick.joint" = 5e-4
[[axes]]
name = "slew"
joint = "slew_joint"
actuation = "velocity"
drives = "joint"
gain = 0.436
[[axes]]
name = "boom"
joint = "boom_joint"
actuation = "velocity"
drives = "cylinder"
gain = 0.025
stroke = [0.0, 0.12]
[[axes]]
name = "stick"
joint = "stick_joint"
actuation = "velocity"
drives = "cylinder"
gain = 0.035
stroke = [0.0, 0.16]
[[axes]]
name = "telescope"
joint = "telescope_joint"
actuation = "velocity"
drives = "joint"
gain = 0.1
"""

#: Boom lengthens and stick shortens its cylinder as the joint angle rises.
LINKAGES = {
    "boom": TriangleLinkage(Linkage("triangle", a=0.12, b=0.20, offset=0.9, retracted=0.15, sense=1)),
    "stick": TriangleLinkage(Linkage("triangle", a=0.10, b=0.25, offset=-0.25, retracted=0.16, sense=-1)),
}
LOW = np.array([-2.6, -0.43, -2.6, 0.0])
HIGH = np.array([2.6, 1.4, -0.1, 0.25])
JOINT_NOISE, CYLINDER_NOISE, POINT_NOISE = 5e-4, 2e-5, 3e-4
AXES = ("slew", "boom", "stick", "telescope")


def crane() -> Machine:
    return machine_from_files({"machine.toml": MACHINE, "crane.urdf": URDF}, "crane")


def motion(name: str, seconds: float = 30.0, seed: int = 0) -> Recording:
    """Sums of slow sines over the joint ranges at 100 Hz, with a gap in motion capture from 40 to 45 %."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * 100)) / 100.0
    share = np.zeros((len(time), 4))
    for frequency in (0.07, 0.13, 0.31):
        share += np.sin(2 * np.pi * frequency * time[:, None] * rng.uniform(0.8, 1.2, 4) + rng.uniform(0, 6.28, 4)) / 3
    q = LOW + (HIGH - LOW) * (0.5 + 0.48 * np.clip(share, -1, 1))
    table = measured(q, rng)
    gap = slice(int(0.40 * len(time)), int(0.45 * len(time)))
    table.loc[table.index[gap], ["boom.joint", "stick.joint", "ee.x", "ee.y", "ee.z"]] = np.nan
    table.insert(0, "time", time)
    return Recording(name, table, 100.0)


def poses(name: str = "poses", count: int = 300, seed: int = 0, reach: float = 1.0) -> Recording:
    """Uniform random static poses over ``reach`` of the joint ranges."""
    rng = np.random.default_rng(seed)
    q = 0.5 * (LOW + HIGH) + reach * (HIGH - LOW) * rng.uniform(-0.5, 0.5, (count, 4))
    table = measured(q, rng)
    table.insert(0, "time", np.arange(count) * 4.0)
    return Recording(name, table, 100.0, kind="poses")


def measured(q: Array, rng: np.random.Generator) -> pd.DataFrame:
    """What sensors say at joint values ``q`` (n, 4)."""
    kinematics = crane().kinematics()
    assert kinematics is not None
    columns = {}
    for axis in ("boom", "stick"):
        displacement = LINKAGES[axis].displacement(q[:, AXES.index(axis)])
        columns[f"{axis}.cylinder"] = displacement + rng.normal(0, CYLINDER_NOISE, len(q))
    for number, axis in enumerate(AXES):
        noise = CYLINDER_NOISE if axis == "telescope" else JOINT_NOISE
        columns[f"{axis}.joint"] = q[:, number] + rng.normal(0, noise, len(q))
    tip = kinematics.tip_position(q) + rng.normal(0, POINT_NOISE, (len(q), 3))
    columns |= {f"ee.{letter}": tip[:, number] for number, letter in enumerate("xyz")}
    return pd.DataFrame(columns)


def dataset(recordings: tuple[Recording, ...] | None = None, splits: dict[str, Role] | None = None) -> Dataset:
    """Three motion recordings, one of each role, and one of poses, unless others are given."""
    if recordings is None:
        recordings = (motion("run-1", 40.0, 1), motion("run-2", 20.0, 2), motion("run-3", 20.0, 3), poses())
        splits = {"run-1": "fit", "run-2": "select", "run-3": "held_out"} if splits is None else splits
    return Dataset.of(crane(), recordings, splits)


def replaced(recording: Recording, signal: str, values: Array | float) -> Recording:
    """The recording with one signal overwritten."""
    return replace(recording, table=recording.table.assign(**{signal: values}))
