"""Row ``poses``: elastic arms in static poses; joint offsets, link lengths, the base frame and compliance are hidden together.

The encoders measure the motor side. The true joint angle is encoder + offset + compliance times the gravity moment in the
true posture, solved by iteration with MuJoCo's gravity moments. The tip is measured in a frame that is misaligned with the
base: measured = R·tip + translation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.spatial.transform import Rotation

from arms.arm import random_arm
from arms.case import AxisText, Case, Hidden
from arms.rigid import Link, RigidArm, mujoco_model, solid, urdf_text

Array = npt.NDArray[np.float64]

NAME = "poses"
#: Rows at which a pose is held, and their rate [Hz].
HELD, RATE = 20, 20.0
#: Poses of the sets; names of the recordings.
SETS = {"set-1": 250, "set-2": 125, "set-3": 125}
ELEVEN_SETS = {"set-1": 200, "set-2": 100, "set-3": 100}


def cases(seed: int) -> Iterator[Case]:
    """A six-axis arm with 500 poses; of every tenth seed also one with eleven joints and 400 poses."""
    yield make(seed)
    if seed % 10 == 0:
        yield make(seed, eleven=True)


def make(seed: int, hides: bool = True, eleven: bool = False) -> Case:
    """One set of poses; with nothing hidden the tip differs from the owner's kinematics by the noise alone."""
    draw = np.random.default_rng([seed, 3, eleven])
    build = "ur" if (seed // 2) % 2 == 0 else "anthropomorphic"
    owner = eleven_joints(draw) if eleven else random_arm(draw, build)
    count = len(owner.links)
    sets = ELEVEN_SETS if eleven else SETS
    offset, compliance = np.zeros(count), np.zeros(count)
    translation, rotation = np.zeros(3), np.zeros(3)
    real, hidden = owner, []
    if hides:
        soft = loaded_axes(owner)
        for k in draw.choice(np.arange(1, count - 1), 2, replace=False):
            offset[k] = draw.choice([-1.0, 1.0]) * math.radians(draw.uniform(0.2, 1.2))
            hidden.append(Hidden("joint_offset", owner.names[k], {"offset": float(offset[k])}))
        long = [k for k in range(1, count - 1) if np.linalg.norm(owner.links[k + 1].origin) > 0.25]
        for k in draw.choice(long, min(2, len(long)), replace=False):
            error = float(draw.choice([-1.0, 1.0]) * draw.uniform(1e-3, 6e-3))
            real = longer(real, int(k), error)
            hidden.append(Hidden("link_length_error", owner.names[k], {"error": error}))
        for k in soft:
            compliance[k] = draw.uniform(2e-5, 1e-4)
            hidden.append(Hidden("joint_compliance", owner.names[k], {"compliance": float(compliance[k])}))
        translation, rotation = draw.uniform(-0.015, 0.015, 3), draw.uniform(-0.02, 0.02, 3)
        hidden.append(Hidden("base_misalignment", "base", {"translation": translation.tolist(), "rotation": rotation.tolist()}))
    noise = float(draw.uniform(1e-4, 5e-4))
    logs, clean = {}, {}
    for name, poses in sets.items():
        low, high = owner.limits.T
        q = draw.uniform(low, high, (poses, count))
        tip = Rotation.from_rotvec(rotation).apply(tip_of(real, q, offset, compliance)) + translation
        clean[name] = held(owner.names, q, tip)
        logs[name] = held(owner.names, q, tip + noise * draw.standard_normal(tip.shape))
    return Case(
        row=NAME,
        name=f"{NAME}-{seed:03d}" + ("-eleven" if eleven else ""),
        rate_hz=RATE,
        axes=[AxisText(link.name, "position", joint=f"{link.name}_joint") for link in owner.links],
        logs=logs,
        clean=clean,
        hidden=hidden,
        noise={f"ee.{letter}": noise for letter in "xyz"},
        urdf=urdf_text(owner),
        poses=True,
        extra={"tip_noise": noise, "poses": sum(sets.values()), "joints": count},
    )


def eleven_joints(draw: np.random.Generator) -> RigidArm:
    """A torso of yaw, two pitches and roll that carries an arm of seven joints."""
    axes = [
        (0, 0, 1),
        (0, 1, 0),
        (0, 1, 0),
        (1, 0, 0),
        (0, 0, 1),
        (0, 1, 0),
        (0, 0, 1),
        (0, 1, 0),
        (0, 0, 1),
        (0, 1, 0),
        (1, 0, 0),
    ]
    long = {2: (0.0, 0.0, 0.4), 3: (0.0, 0.0, 0.35), 7: (0.0, 0.0, 0.32), 9: (0.0, 0.0, 0.28)}
    links = []
    for k, axis in enumerate(axes):
        origin = tuple(value * draw.uniform(0.9, 1.1) for value in long.get(k, (0.05, 0.02, 0.08)))
        mass = float(np.interp(k, [0, 10], [8.0, 1.0]) * draw.uniform(0.8, 1.2))
        size = (0.1, 0.1, 0.25)
        centre = (0.01, 0.0, 0.12)
        links.append(
            Link(f"a{k + 1}", origin, axis, (-0.9, 0.9), 100.0, mass, centre, solid(mass, size))  # type: ignore[arg-type]
        )
    return RigidArm(tuple(links), (0.12, 0.0, 0.06))


def loaded_axes(arm: RigidArm) -> list[int]:
    """The pitch axes of the first links, which carry the weight of the others."""
    return [k for k, link in enumerate(arm.links) if link.axis == (0, 1, 0)][:2]


def longer(arm: RigidArm, k: int, error: float) -> RigidArm:
    """The arm whose link ``k`` is longer by ``error`` [m], towards the joint after it."""
    links = list(arm.links)
    origin = np.array(links[k + 1].origin)
    x, y, z = (float(value) for value in origin * (1.0 + error / np.linalg.norm(origin)))
    links[k + 1] = replace(links[k + 1], origin=(x, y, z))
    return replace(arm, links=tuple(links))


def tip_of(arm: RigidArm, q: Array, offset: Array, compliance: Array) -> Array:
    """Tip (n, 3) [m] in the base frame for encoder angles (n, axes)."""
    import mujoco

    model, data = mujoco_model(arm)
    found = np.empty((len(q), 3))
    for row, measured in enumerate(q):
        true = measured + offset
        for _ in range(50):
            data.qpos[:] = true
            mujoco.mj_forward(model, data)
            # The bias force is what holds the arm; gravity pulls the other way.
            settled = measured + offset - compliance * data.qfrc_bias
            moved = np.abs(settled - true).max()
            true = settled
            if moved < 1e-12:
                break
        data.qpos[:] = true
        mujoco.mj_forward(model, data)
        found[row] = data.site_xpos[0]
    return found


def held(names: list[str], q: Array, tip: Array) -> pd.DataFrame:
    """Poses as a log: each row is held, as datasets/ur10/recipe.toml states it."""
    columns: dict[str, Any] = {f"{name}.joint": q[:, k] for k, name in enumerate(names)}
    columns |= {f"ee.{letter}": tip[:, k] for k, letter in enumerate("xyz")}
    table = pd.DataFrame(columns)
    table = table.loc[table.index.repeat(HELD)].reset_index(drop=True)
    table.insert(0, "time", np.arange(len(table)) / RATE)
    return table
