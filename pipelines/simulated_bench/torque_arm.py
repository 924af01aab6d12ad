"""An arm of three geared motors: a column that turns about the vertical, and two links in the plane that turns with it.

Links are slender rods. A rod has the mass, the first and the second moment of two points of half its mass at the nodes of
Gauss's quadrature, so that the arm is a set of points. With the distance ρ from the vertical, the height z and the angle φ of
the column, the torques of a motion are

    column:  Σ m·(ρ²·φ̈ + 2·ρ·ρ̇·φ̇)
    link j:  Σ m·((ρ̈ − ρ·φ̇²)·∂ρ/∂q_j + (z̈ + g)·∂z/∂q_j)

and beside them those of rotor and friction of each joint. A stiff controller lets the joints follow their path.

Source: Lagrange's equations; Swevers et al., IEEE Trans. Robot. Autom. 13 (1997), 730–740 (Fourier series as path).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from simulated_bench.joint_recipe import Take
from sysid.config import Strict

Array = npt.NDArray[np.float64]
Function = Callable[[Array], Array]

GRAVITY = 9.80665
#: Harmonics of the path, their lowest frequency [Hz], and the share of its range that an axis moves over.
HARMONICS, FREQUENCY, SHARE = 5, 0.1, 0.8
#: Nodes of the quadrature on a rod of length one.
NODES = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))


@dataclass(frozen=True)
class Motor(Strict):
    """One joint: ``limits`` [rad], ``length`` and ``mass`` of its link [m, kg] (of the first the height of the column).

    Args:
        rotor: inertia of the rotor at the joint [kg·m²]. constant: torque per current at the joint [N·m/A].
        coulomb [N·m], viscous [N·m·s/rad]: friction.
    """

    name: str
    limits: tuple[float, float]
    length: float
    mass: float
    rotor: float
    constant: float
    coulomb: float = 0.0
    viscous: float = 0.0


@dataclass(frozen=True)
class TorqueArm(Strict):
    """The arm: ``payload`` at the tip [kg], ``noise`` of encoders [rad], ``current_noise`` [A], ``rate`` of the log [Hz]."""

    kind: Literal["torque_arm"]
    name: str
    seed: int
    axes: tuple[Motor, Motor, Motor]
    recordings: tuple[Take, ...]
    payload: float = 0.0
    rate: float = 100.0
    noise: float = 0.0
    current_noise: float = 0.0


def run_torque_arm(arm: TorqueArm, take: Take) -> tuple[Array, Array, Array]:
    """Time (n,) [s], currents [A] and joints [rad] (n, 3) at the log's rate, without noise."""
    time = np.arange(round(take.seconds * arm.rate)) / arm.rate
    rng = np.random.default_rng([arm.seed, take.seed])
    paths = [_path(axis.limits, time, rng) for axis in arm.axes]
    q, v, a = (np.stack([path[k] for path in paths], axis=1) for k in range(3))
    torque = torques(arm, q, v, a)
    return time, torque / np.array([axis.constant for axis in arm.axes]), q


def torques(arm: TorqueArm, q: Array, v: Array, a: Array) -> Array:
    """Torques of the motors at positions, speeds and accelerations (n, 3) [N·m]."""
    total = np.zeros_like(q)
    turn, spin = v[:, 0], a[:, 0]
    for mass, first, second in _points(arm):
        rho, rho_v, rho_a, rho_by = _projected(q, v, a, first, second, np.cos, lambda x: -np.sin(x))
        _, _, z_a, z_by = _projected(q, v, a, first, second, np.sin, np.cos)
        total[:, 0] += mass * (rho**2 * spin + 2.0 * rho * rho_v * turn)
        for j in range(2):
            total[:, 1 + j] += mass * ((rho_a - rho * turn**2) * rho_by[j] + (z_a + GRAVITY) * z_by[j])
    for k, axis in enumerate(arm.axes):
        total[:, k] += axis.rotor * a[:, k] + axis.viscous * v[:, k] + axis.coulomb * np.sign(v[:, k])
    return total


def _points(arm: TorqueArm) -> list[tuple[float, float, float]]:
    """Mass and distances along both links of every point: (m, along the first, along the second)."""
    upper, fore = arm.axes[1], arm.axes[2]
    points = [(0.5 * upper.mass, node * upper.length, 0.0) for node in NODES]
    points += [(0.5 * fore.mass, upper.length, node * fore.length) for node in NODES]
    return [*points, (arm.payload, upper.length, fore.length)]


def _projected(
    q: Array, v: Array, a: Array, first: float, second: float, shape: Function, slope: Function
) -> tuple[Array, Array, Array, tuple[Array, Array]]:
    """Coordinate first·f(q₂) + second·f(q₂ + q₃) with its rates and its derivatives by both angles; f'' = −f."""
    low, high = q[:, 1], q[:, 1] + q[:, 2]
    low_v, high_v, low_a, high_a = v[:, 1], v[:, 1] + v[:, 2], a[:, 1], a[:, 1] + a[:, 2]
    own = first * shape(low) + second * shape(high)
    rate = first * slope(low) * low_v + second * slope(high) * high_v
    change = first * (slope(low) * low_a - shape(low) * low_v**2) + second * (slope(high) * high_a - shape(high) * high_v**2)
    by_high = second * slope(high)
    return own, rate, change, (first * slope(low) + by_high, by_high)


def _path(limits: tuple[float, float], time: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration of a Fourier series within a share of the limits."""
    k = np.arange(1, HARMONICS + 1)
    rate = 2.0 * math.pi * FREQUENCY * k
    size, phase = rng.uniform(0.3, 1.0, HARMONICS) / k, rng.uniform(0.0, 2.0 * math.pi, HARMONICS)
    angle = time[:, None] * rate + phase
    low, high = limits
    scale = 0.5 * SHARE * (high - low) / size.sum()
    middle = 0.5 * (low + high)
    position = middle + scale * (size * np.sin(angle)).sum(axis=1)
    speed = scale * (size * rate * np.cos(angle)).sum(axis=1)
    return position, speed, -scale * (size * rate**2 * np.sin(angle)).sum(axis=1)


def description(arm: TorqueArm) -> dict[str, str]:
    """``machine.toml`` and URDF: file name → text, without friction and payload."""
    lines = ["schema = 1", f'name = "{arm.name}"', f"rate_hz = {arm.rate}", f'urdf = "{arm.name}.urdf"', 'tip = "tip"']
    for axis in arm.axes:
        lines += ["", "[[axes]]", f'name = "{axis.name}"', f'joint = "{axis.name}_joint"']
        lines += ['actuation = "force"', 'drives = "joint"', f"inertia = {axis.rotor}"]
    return {"machine.toml": "\n".join(lines) + "\n", f"{arm.name}.urdf": _urdf(arm)}


def _urdf(arm: TorqueArm) -> str:
    column, upper, fore = arm.axes
    parts = [f'<?xml version="1.0"?>\n<robot name="{arm.name}">\n  <link name="base"/>']
    before = ("base", f"0 0 {column.length}"), (f"{column.name}_link", "0 0 0"), (f"{upper.name}_link", f"{upper.length} 0 0")
    for axis, (parent, origin), turn in zip(arm.axes, before, ("0 0 1", "0 -1 0", "0 -1 0"), strict=True):
        about = 1e-6 if axis is column else axis.mass * axis.length**2 / 12.0
        centre = "0 0 0" if axis is column else f"{0.5 * axis.length} 0 0"
        parts.append(
            f'  <joint name="{axis.name}_joint" type="revolute"><parent link="{parent}"/><child link="{axis.name}_link"/>'
            f'<origin xyz="{origin}"/><axis xyz="{turn}"/>'
            f'<limit lower="{axis.limits[0]}" upper="{axis.limits[1]}" velocity="5" effort="500"/></joint>\n'
            f'  <link name="{axis.name}_link"><inertial><origin xyz="{centre}"/><mass value="{axis.mass}"/>'
            f'<inertia ixx="1e-6" ixy="0" ixz="0" iyy="{about}" iyz="0" izz="{about}"/></inertial></link>'
        )
    parts.append(
        f'  <joint name="tip_joint" type="fixed"><parent link="{fore.name}_link"/><child link="tip"/>'
        f'<origin xyz="{fore.length} 0 0"/></joint>\n  <link name="tip"/>\n</robot>'
    )
    return "\n".join(parts) + "\n"
