"""Row ``flexible``: two-mass drives, on a force axis and on a velocity axis.

Motor and load are two inertias with a spring and a damper between them:

    Jm·q̈m = τ − friction(q̇m) − k·(qm − ql) − d·(q̇m − q̇l)
    Jl·q̈l = k·(qm − ql) + d·(q̇m − q̇l)

On the force axis torque and motor angle are logged, and the owner knows the sum of the inertias. On the velocity axis the motor
follows the commanded speed with a known lag, and the angle of the load is logged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
import pandas as pd

from arms.case import AxisText, Case, Hidden, noisy
from arms.motion import chirp, multisine, steps

Array = npt.NDArray[np.float64]

NAME = "flexible"
#: Step of the simulation [s].
STEP = 2e-5
PROGRAMS = ("chirp", "multisine", "steps", "multisine", "chirp")


@dataclass(frozen=True)
class Drive:
    """Inertias [kg·m²], stiffness [N·m/rad], damping [N·m·s/rad], friction of the motor [N·m·s/rad, N·m]."""

    motor: float
    load: float
    stiffness: float
    damping: float
    viscous: float
    coulomb: float

    @property
    def antiresonance(self) -> float:
        """Of the motor angle, which is the load's frequency with the motor held [Hz]."""
        return math.sqrt(self.stiffness / self.load) / (2.0 * math.pi)

    @property
    def resonance(self) -> float:
        """Of the free drive [Hz]."""
        return math.sqrt(self.stiffness * (1.0 / self.motor + 1.0 / self.load)) / (2.0 * math.pi)


def cases(seed: int) -> Iterator[Case]:
    """The same drive as a force axis and as a velocity axis."""
    yield make_force(seed)
    yield make_velocity(seed)


def random_drive(draw: np.random.Generator) -> Drive:
    """Antiresonance and resonance between 5 and 60 Hz."""
    total = float(np.exp(draw.uniform(math.log(0.05), math.log(2.0))))
    ratio = draw.uniform(0.4, 3.0)
    motor, load = total / (1.0 + ratio), total * ratio / (1.0 + ratio)
    highest = 60.0 / math.sqrt(1.0 + ratio)
    frequency = 2.0 * math.pi * float(np.exp(draw.uniform(math.log(6.0), math.log(highest))))
    damping = 2.0 * draw.uniform(0.01, 0.06) * load * frequency
    # Friction relative to the torque that moves the drive at 10 rad/s².
    size = 10.0 * total
    return Drive(motor, load, load * frequency**2, damping, draw.uniform(0.02, 0.1) * size, draw.uniform(0.05, 0.2) * size)


def make_force(seed: int, flexible: bool = True, friction: bool = True) -> Case:
    """Force axis; a rigid drive is one whose spring is 10⁴ times as stiff."""
    draw = np.random.default_rng([seed, 4])
    drive = random_drive(draw)
    if not flexible:
        drive = Drive(drive.motor + 0.999 * drive.load, 0.001 * drive.load, 10.0 * drive.stiffness, 5.0 * drive.damping,
                      drive.viscous, drive.coulomb)  # fmt: skip
    if not friction:
        drive = Drive(drive.motor, drive.load, drive.stiffness, drive.damping, 0.0, 0.0)
    total = drive.motor + drive.load
    rate = float(draw.choice([500.0, 1000.0]))
    largest = 12.0 * total
    noise_q, noise_t = float(draw.uniform(1e-5, 5e-5)), float(draw.uniform(0.003, 0.01)) * largest
    logs, clean = {}, {}
    for k, program in enumerate(PROGRAMS):
        time = np.arange(round(draw.uniform(15.0, 20.0) * rate)) / rate
        # Held over a row of the log, as a digital drive does; a soft spring to the middle keeps the axis in place.
        wanted = largest * (0.6 * _program(draw, program, time, 0.3, min(80.0, 0.3 * rate)) + 0.4 * _slow(draw, time))
        torque, q = simulate_force(drive, wanted, 1.0 / rate, total * 3.0**2, 2.0 * 0.3 * total * 3.0)
        table = pd.DataFrame({"time": time, "drive.command": torque, "drive.joint": q})
        clean[f"{program}-{k + 1}"] = table
        logs[f"{program}-{k + 1}"] = noisy(table, {"drive.command": noise_t, "drive.joint": noise_q}, draw)
    hidden = []
    if flexible:
        hidden.append(Hidden("flexible_drive", "drive", _truth(drive)))
    if friction:
        hidden.append(Hidden("viscous_friction", "drive", {"coefficient": drive.viscous}))
        hidden.append(Hidden("coulomb_friction", "drive", {"force": drive.coulomb}))
    return Case(
        row=NAME,
        name=f"{NAME}-{seed:03d}-force",
        rate_hz=rate,
        axes=[AxisText("drive", "force", limits=(-6.3, 6.3), inertia=total)],
        logs=logs,
        clean=clean,
        hidden=hidden,
        noise={"drive.joint": noise_q},
        extra={
            "variant": "force",
            "torque_noise": {"drive": noise_t},
            "joint_noise": noise_q,
            "inertia": {"drive": drive.motor},
            "rate_hz": rate,
        },
    )


def make_velocity(seed: int, flexible: bool = True) -> Case:
    """Velocity axis with known gain and lag."""
    draw = np.random.default_rng([seed, 5])
    drive = random_drive(draw)
    gain, lag = float(draw.uniform(0.5, 2.0)), float(draw.uniform(0.003, 0.01))
    rate = float(draw.choice([500.0, 1000.0]))
    noise = float(draw.uniform(1e-5, 5e-5))
    logs, clean = {}, {}
    for k, program in enumerate(PROGRAMS):
        time = np.arange(round(draw.uniform(15.0, 20.0) * rate)) / rate
        command = 0.6 * _program(draw, program, time, 0.5, 60.0) + 0.3 * _slow(draw, time)
        q = simulate_velocity(drive, command, 1.0 / rate, gain, lag, flexible)
        table = pd.DataFrame({"time": time, "drive.command": command, "drive.joint": q})
        clean[f"{program}-{k + 1}"] = table
        logs[f"{program}-{k + 1}"] = noisy(table, {"drive.joint": noise}, draw)
    hidden = [Hidden("flexible_drive_velocity", "drive", _truth(drive))] if flexible else []
    return Case(
        row=NAME,
        name=f"{NAME}-{seed:03d}-velocity",
        rate_hz=rate,
        axes=[AxisText("drive", "velocity", limits=(-20.0, 20.0), gain=gain)],
        logs=logs,
        clean=clean,
        hidden=hidden,
        noise={"drive.joint": noise},
        known=[Hidden("first_order_lag", "drive", {"time_constant": lag})],
        extra={"variant": "velocity"},
    )


def _truth(drive: Drive) -> dict[str, float]:
    return {
        "stiffness": drive.stiffness,
        "damping": drive.damping,
        "motor_inertia": drive.motor,
        "load_inertia": drive.load,
        "antiresonance_hz": drive.antiresonance,
        "resonance_hz": drive.resonance,
        "frequency": drive.antiresonance,
        "inertia_ratio": drive.load / drive.motor,
        "damping_ratio": drive.damping / (2.0 * math.sqrt(drive.stiffness * drive.load)),
    }


def _program(draw: np.random.Generator, program: str, time: Array, first: float, last: float) -> Array:
    if program == "chirp":
        return chirp(time, first, last)
    if program == "multisine":
        return multisine(draw, time, first, last, 60)
    return steps(draw, time, 0.15, 0.8)


def _slow(draw: np.random.Generator, time: Array) -> Array:
    return multisine(draw, time, 0.1, 1.0, 6)


# ---- Simulation ---------------------------------------------------------------------------------------------------------


def simulate_force(drive: Drive, wanted: Array, period: float, spring: float, damper: float) -> tuple[Array, Array]:
    """Applied torque and motor angle (n,), each row's torque being held until the next."""
    count = round(period / STEP)
    masses = drive.motor, drive.load, drive.stiffness, drive.damping, drive.viscous, drive.coulomb
    return _force(wanted, period, count, *masses, spring, damper)  # type: ignore[no-any-return]


def simulate_velocity(drive: Drive, command: Array, period: float, gain: float, lag: float, flexible: bool) -> Array:
    """Angle of the load (n,), or of the motor where the drive is rigid."""
    return _velocity(command, period, round(period / STEP), drive.load, drive.stiffness, drive.damping, gain, lag, flexible)


@numba.njit(cache=True)
def _force(wanted, period, count, jm, jl, k, d, viscous, coulomb, spring, damper):  # type: ignore[no-untyped-def]
    dt = period / count
    qm = ql = vm = vl = 0.0
    torque, angle = np.empty(len(wanted)), np.empty(len(wanted))
    for row in range(len(wanted)):
        applied = wanted[row] - spring * qm - damper * vm
        torque[row], angle[row] = applied, qm
        for _ in range(count):
            twist = k * (qm - ql) + d * (vm - vl)
            free = vm + dt * (applied - viscous * vm - twist) / jm
            # Coulomb friction stops the motor within the step, or acts in full.
            change = dt * coulomb / jm
            vm = 0.0 if abs(free) <= change else free - math.copysign(change, free)
            vl += dt * twist / jl
            qm += dt * vm
            ql += dt * vl
    return torque, angle


@numba.njit(cache=True)
def _velocity(command, period, count, jl, k, d, gain, lag, flexible):  # type: ignore[no-untyped-def]
    dt = period / count
    qm = ql = vm = vl = 0.0
    share = 1.0 - math.exp(-dt / lag)
    angle = np.empty(len(command))
    for row in range(len(command)):
        angle[row] = ql if flexible else qm
        for _ in range(count):
            vm += share * (gain * command[row] - vm)
            vl += dt * (k * (qm - ql) + d * (vm - vl)) / jl
            qm += dt * vm
            ql += dt * vl
    return angle
