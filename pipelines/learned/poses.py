"""Poses of the bench crane: its own forward kinematics, the noise of its sensors, and a drawing that is a little off."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from simulated_bench.crane import link_poses
from simulated_bench.cylinder import drive_of, joint_of, position_of
from simulated_bench.recipe import AXES, BenchRecipe
from simulated_bench.recipe_file import load_recipe
from simulated_bench.sensors import read_slew, read_wires
from simulated_bench.site_files import urdf
from sysid.machine.kinematics import Kinematics
from sysid.networks import Geometry

Array = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]

ANGLES = (True, True, True, False)
JOINTS = tuple(f"{name}.joint" for name in AXES)
#: Motion capture of two rigid bodies (joints) or one (the tip); the telescope by its draw wire [rad, m].
JOINT_NOISE = np.array([5e-4, 9.4e-4, 8.9e-4, 2e-5])
TIP_NOISE = np.full(3, 3e-4)
#: By how much a drawing is off, uniform to either side: every coordinate and every angle of a joint's origin [m, rad].
DRAWN_LENGTH, DRAWN_ANGLE = 3e-3, math.radians(1.0)
#: Full joint ranges, and the sub-space: slew ±45°, the middle 70 % of the others.
RANGES = ("full", "part")
PART_SLEW, PART_SHARE = math.pi / 4.0, 0.7
HELD_OUT = 1000


@dataclass(frozen=True)
class Poses:
    """Joint values (n, 4) as they are, as motion capture sees them and as the machine's own sensors do; tip (n, 3) likewise."""

    joints: Array
    captured: Array
    own: Array
    tip: Array
    seen_tip: Array


@cache
def crane() -> BenchRecipe:
    return load_recipe(ROOT / "datasets" / "autolog" / "bench.toml")


def limits(reach: str) -> tuple[Array, Array]:
    """Lowest and highest joint values, (4,) each."""
    low, high = (np.array([crane().axis(name).limits[end] for name in AXES]) for end in (0, 1))
    if reach == "full":
        return low, high
    middle, half = 0.5 * (low + high), 0.5 * PART_SHARE * (high - low)
    half[0] = PART_SLEW
    return middle - half, middle + half


def poses(reach: str, count: int, *seed: int) -> Poses:
    """Poses uniform over the joint ranges."""
    rng, recipe = np.random.default_rng(seed), crane()
    low, high = limits(reach)
    joints = rng.uniform(low, high, (count, len(AXES)))
    tip = link_poses(recipe.geometry, joints, np.zeros((count, 3)))["tip"][1]
    captured = joints + JOINT_NOISE * rng.standard_normal(joints.shape)
    own = joints.copy()
    own[:, 0] = read_slew(joints[:, 0], recipe.slew_sensor, rng)
    for column, name in enumerate(AXES[1:], 1):
        drive = drive_of(recipe.axis(name))
        wires = read_wires(np.array([position_of(value, drive) for value in joints[:, column]]), recipe.draw_wire, rng)
        own[:, column] = [joint_of(value, drive) for value in wires]
    return Poses(joints, captured, own, tip, tip + TIP_NOISE * rng.standard_normal(tip.shape))


def drawing(seed: int) -> Geometry:
    """A drawing of the crane with small errors in every joint's origin."""
    rng = np.random.default_rng([seed, 77])

    def moved(found: re.Match[str]) -> str:
        place = np.array(found.group(2).split(), dtype=np.float64) + DRAWN_LENGTH * rng.uniform(-1.0, 1.0, 3)
        angles = DRAWN_ANGLE * rng.uniform(-1.0, 1.0, 3)
        return f'{found.group(1)}<origin xyz="{" ".join(map(str, place))}" rpy="{" ".join(map(str, angles))}"/>'

    text, count = re.subn(
        r'(_joint" type="(?:revolute|prismatic)">.*?)<origin xyz="([^"]*)"/>', moved, urdf(crane()), flags=re.S
    )
    assert count == len(AXES)
    return Geometry(Kinematics.from_urdf(text, tuple(f"{name}_joint" for name in AXES), "tip"))
