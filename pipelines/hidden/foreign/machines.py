"""The machines of the foreign simulators as their owners describe them: tables of numbers, variants of each family.

MuJoCo (Todorov, Erez, Tassa, IROS 2012): a crane, a servo arm, a slide pushed by a force. PyBullet (Coumans and Bai): a servo
arm, and a lever turned by a torque. The equations of motion, frictions, delays, filters, limits and contacts are the
simulator's; what is written here are its settings.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, Literal

import numpy as np

Family = Literal["mujoco_crane", "mujoco_arm", "mujoco_slide", "bullet_arm", "bullet_lever"]
Tables = dict[str, Any]
_FAMILIES: tuple[str, ...] = ("mujoco_crane", "mujoco_arm", "mujoco_slide", "bullet_arm", "bullet_lever")
#: Of each family: other sizes, speeds, dead times; every second one has dry friction that its owner knows.
VARIANTS = 4
#: Step of the simulators [s]; finer where servos are stiff, and where forces are compared, which a step holds.
STEP, FINE = 1e-3, 5e-4
PUSHED_STEP = {"mujoco_slide": 1e-4, "bullet_lever": 2.5e-4}
CRANE_AXES = ("slew", "boom", "stick", "telescope")
ARM_AXES = ("shoulder", "elbow")
#: Axes that a force moves, by family.
FORCE_AXIS = {"mujoco_slide": "carriage", "bullet_lever": "lever"}
#: Cranes whose boom and stick carry their weight on the drive, which holds its place; in the others springs carry it.
LOADED = (1, 3)
#: MuJoCo arms whose servos are DC motors with a controller, which can limit its rate.
CONTROLLED = (1, 3)
#: Standard deviations at noise 1: angle [rad], length [m], marker coordinate [m], force [N], torque [N·m]; of a force axis the
#: encoder [m or rad].
ANGLE, LENGTH, MARKER, FORCE, TORQUE, ENCODER = 3e-4, 1e-4, 1.5e-4, 1.0, 0.1, 2e-6


@cache
def known_tables(family: str, variant: int) -> Tables:
    """What the machine is when nothing is hidden in it; recordings and noise not yet in it."""
    draw = np.random.default_rng([_FAMILIES.index(family), variant, 4])
    if family == "mujoco_crane":
        return _crane(variant, draw)
    if family in ("mujoco_arm", "bullet_arm"):
        return _arm(family, variant, draw)
    return _pushed(family, variant, draw)


def _crane(variant: int, draw: np.random.Generator) -> Tables:
    """Geared drives: the rotors' inertia, seen behind the gear, is far above that of the arm."""
    limits = {"slew": (-2.4, 2.4), "boom": (-0.4, 1.3), "stick": (-2.4, -0.2), "telescope": (0.0, 0.4)}
    gains = {"slew": 0.4, "boom": 0.25, "stick": 0.4, "telescope": 0.1}
    axes: Tables = {}
    for name in CRANE_AXES:
        axes[name] = {
            "limits": list(limits[name]),
            "gain": round(gains[name] * draw.uniform(0.8, 1.2), 4),
            "delay": round(draw.uniform(0.01, 0.04), 3),
            "lag": round(draw.uniform(0.03, 0.08), 4),
            "servo": "place" if variant in LOADED and name != "slew" else "speed",
            "friction": 0.0,
        }
        if variant >= 2 and axes[name]["servo"] == "speed":
            # As a share of the force at which the drive would stop at full command. Dry friction ends a lag sooner than a
            # dead-band before it does; a plant that has the latter is close where the lag is short.
            axes[name] |= {"friction": round(draw.uniform(0.008, 0.018), 4), "lag": round(draw.uniform(0.008, 0.014), 4)}
    return {
        "family": "mujoco_crane",
        "rate": 100.0,
        "step": STEP,
        "gravity_carried": variant not in LOADED,
        "links": {name: round(size * draw.uniform(0.9, 1.1), 3) for name, size in _SIZES.items()},
        "axes": axes,
        "tool": {"length": 0.2, "damping_ratio": 0.05} if variant % 2 else {"length": 0.0, "damping_ratio": 0.0},
        "build": {"turn": {}, "longer": {}, "translation": [0.0, 0.0, 0.0], "rotation": [0.0, 0.0, 0.0]},
        "sensors": {},
    }


_SIZES = {"height": 0.4, "boom": 0.8, "stick": 0.6}


def _arm(family: str, variant: int, draw: np.random.Generator) -> Tables:
    axes: Tables = {}
    for name, limits in (("shoulder", (-0.5, 1.5)), ("elbow", (-2.0, 0.5))):
        axes[name] = {
            "limits": list(limits),
            "length": round(draw.uniform(0.2, 0.35), 3),
            "mass": round(draw.uniform(0.3, 1.0), 2),
            "delay": round(draw.uniform(0.01, 0.03), 3) if family == "mujoco_arm" else 0.0,
            "lag": round(draw.uniform(0.03, 0.06), 4),
        }
    # MuJoCo has two servos: a position actuator behind a filter, and a DC motor with a controller.
    motor = "dcmotor" if family == "mujoco_arm" and variant in CONTROLLED else "position"
    step = FINE if family == "mujoco_arm" else STEP
    return {"family": family, "rate": 100.0, "step": step, "motor": motor, "gravity": 0.0, "axes": axes, "sensors": {}}


def _pushed(family: str, variant: int, draw: np.random.Generator) -> Tables:
    if family == "mujoco_slide":
        known = {"inertia": round(draw.uniform(40.0, 100.0), 1), "viscous": round(draw.uniform(80.0, 200.0), 1)}
        known["coulomb"] = round(draw.uniform(10.0, 20.0), 1) if variant % 2 else 0.0
        limits = [-0.35, 0.35]
    else:
        known = {"inertia": round(draw.uniform(0.5, 1.5), 3), "viscous": round(draw.uniform(1.0, 2.5), 3)}
        known["coulomb"] = round(draw.uniform(0.5, 1.0), 2) if variant % 2 else 0.0
        limits = [-0.6 * math.pi, 0.6 * math.pi]
    return {
        "family": family,
        "rate": 1000.0,
        "step": PUSHED_STEP[family],
        "limits": limits,
        "load": 0.0,
        "sensors": {},
        **known,
    }


def noise_of(tables: Tables, noise: float) -> dict[str, float]:
    """Standard deviation by signal at ``noise`` times the usual; of commands only a force is a measurement."""
    family = tables["family"]
    if family in FORCE_AXIS:
        axis = FORCE_AXIS[family]
        force = FORCE if family == "mujoco_slide" else TORQUE
        return {f"{axis}.command": force * noise, f"{axis}.joint": ENCODER * noise}
    found = {f"{axis}.joint": (LENGTH if axis == "telescope" else ANGLE) * noise for axis in tables["axes"]}
    if family == "mujoco_crane":
        found |= {f"{point}.{c}": MARKER * noise for point in ("ee", "tool") for c in "xyz"}
    return found


def axes_of(tables: Tables) -> tuple[str, ...]:
    """Names of the axes, in kinematic order."""
    return tuple(tables["axes"]) if "axes" in tables else (FORCE_AXIS[tables["family"]],)
