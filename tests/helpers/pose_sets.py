"""Static poses of a simulated elastic arm, independent of the plant: rotations of scipy, moments from the weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.spatial.transform import Rotation

from sysid.datasets.recording import Dataset, Recording, Role
from sysid.machine import Machine, machine_from_files

Array = npt.NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -9.80665])
AXES = {"x": np.eye(3)[0], "y": np.eye(3)[1], "z": np.eye(3)[2]}


@dataclass(frozen=True)
class Arm:
    """A chain: ``axes`` of its joints in the frame before them; ``links`` (A, 3) from each joint to the next [m]; ``masses``
    [kg], each in the middle of its link."""

    axes: str = "zyyxyx"
    links: Sequence[Sequence[float]] = (
        (0.0, 0.05, 0.35), (0.5, -0.04, 0.0), (0.45, 0.03, 0.05), (0.12, 0.05, 0.04), (0.11, 0.0, 0.06), (0.09, 0.05, 0.02),
    )  # fmt: skip
    masses: Sequence[float] = (8.0, 9.0, 6.0, 3.0, 2.0, 2.0)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"j{k}" for k in range(1, len(self.axes) + 1))

    def urdf(self) -> str:
        """The nominal arm."""
        parts = ['<robot name="arm"><link name="l0"/>']
        before = (0.0, 0.0, 0.0)
        for k, (axis, link, mass) in enumerate(zip(self.axes, self.links, self.masses, strict=True), 1):
            centre = " ".join(str(0.5 * v) for v in link)
            parts.append(
                f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
                f'<origin xyz="{" ".join(map(str, before))}"/><axis xyz="{" ".join(map(str, AXES[axis].astype(int)))}"/>'
                '<limit lower="-3" upper="3" effort="100" velocity="1"/></joint>'
                f'<link name="l{k}"><inertial><mass value="{mass}"/><origin xyz="{centre}"/>'
                '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            )
            before = tuple(link)
        last = " ".join(map(str, before))
        parts.append(
            f'<joint name="tool" type="fixed"><parent link="l{len(self.axes)}"/><child link="tip"/>'
            f'<origin xyz="{last}"/></joint>'
            '<link name="tip"/></robot>'
        )
        return "".join(parts)

    def machine(self, noise: float, marker: bool = False) -> Machine:
        """The nominal arm with ``noise`` of the tip [m]; ``marker``: the place of the measured point is not known."""
        lines = ["schema = 1", 'name = "arm"', "rate_hz = 20.0", 'urdf = "arm.urdf"', 'tip = "tip"']
        for name in self.names:
            lines += ["[[axes]]", f'name = "{name}"', f'joint = "{name}"', 'actuation = "position"', 'drives = "joint"']
        lines += ["[noise]", *(f'"ee.{c}" = {noise}' for c in "xyz")]
        if marker:
            lines += ["[[effects]]", 'name = "tip_offset"', 'target = "ee"', "parameters = { translation = [0.0, 0.0, 0.0] }"]
        return machine_from_files({"machine.toml": "\n".join(lines) + "\n", "arm.urdf": self.urdf()}, "arm")


@dataclass(frozen=True)
class Hidden:
    """What differs from the URDF, as in the contract; joints are numbered from 0."""

    offset: Mapping[int, float] = field(default_factory=dict)
    length: Mapping[int, float] = field(default_factory=dict)
    compliance: Mapping[int, float] = field(default_factory=dict)
    scale: Mapping[int, float] = field(default_factory=dict)
    tilt: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)  # of a link, which no effect describes
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tip: tuple[float, float, float] = (0.0, 0.0, 0.0)  # shift of the measured point in the frame of the last link


def tips(arm: Arm, hidden: Hidden, measured: Array) -> Array:
    """End effector at measured joints (n, A), without noise (n, 3)."""
    q = measured.copy()
    for k, scale in hidden.scale.items():
        q[:, k] /= scale
    for k, offset in hidden.offset.items():
        q[:, k] += offset
    compliance = np.array([hidden.compliance.get(k, 0.0) for k in range(len(arm.axes))])
    straight = q
    for _ in range(40):  # gravity loads the deflected arm
        q = straight - compliance * _chain(arm, hidden, q)[1]
    return Rotation.from_rotvec(hidden.rotation).apply(_chain(arm, hidden, q)[0]) + np.array(hidden.translation)


def _chain(arm: Arm, hidden: Hidden, q: Array) -> tuple[Array, Array]:
    """End effector (n, 3), and the gravity moment about each joint, above zero where it opposes positive motion (n, A)."""
    n = len(q)
    turn, at = Rotation.identity(n), np.zeros((n, 3))
    pivots, directions, centres = [], [], []
    for k, (axis, link) in enumerate(zip(arm.axes, arm.links, strict=True)):
        pivots.append(at)
        directions.append(turn.apply(np.tile(AXES[axis], (n, 1))))
        turn = turn * Rotation.from_rotvec(q[:, k, None] * AXES[axis]) * Rotation.from_rotvec(hidden.tilt.get(k, (0, 0, 0)))
        step = np.array(link)
        longer = step * (1.0 + hidden.length.get(k, 0.0) / np.linalg.norm(step))
        centres.append(at + turn.apply(np.tile(0.5 * step, (n, 1))))
        at = at + turn.apply(np.tile(longer, (n, 1)))
    loads = np.zeros((n, len(arm.axes)))
    for k in range(len(arm.axes)):
        moment = sum(np.cross(centres[j] - pivots[k], arm.masses[j] * DOWN) for j in range(k, len(arm.axes)))
        loads[:, k] = -np.einsum("ni,ni->n", directions[k], moment)
    return at + turn.apply(np.tile(hidden.tip, (n, 1))), loads


def pose_set(
    arm: Arm, hidden: Hidden, count: int, noise: float, seed: int, name: str = "set", joints: Array | None = None
) -> Recording:
    """Random poses (or ``joints``) with their noisy tips."""
    draw = np.random.default_rng(seed)
    q = draw.uniform(-1.6, 1.6, (count, len(arm.axes))) if joints is None else joints
    ends = tips(arm, hidden, q) + draw.normal(0.0, noise, (len(q), 3))
    table = {"time": np.arange(len(q), dtype=np.float64)}
    table |= {f"{axis}.joint": q[:, k] for k, axis in enumerate(arm.names)}
    table |= {f"ee.{c}": ends[:, k] for k, c in enumerate("xyz")}
    return Recording(name, pd.DataFrame(table), 20.0, kind="poses")


def dataset_of(
    arm: Arm, noise: float, *sets: Recording, roles: Mapping[str, Role] | None = None, marker: bool = False
) -> Dataset:
    return Dataset.of(arm.machine(noise, marker), sets, roles)
