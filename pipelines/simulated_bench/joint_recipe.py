"""Settings of the machines without valves: an arm of servo axes, and a slide moved by a force."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from sysid.config import Strict

#: Step of the simulation [s].
STEP = 1e-3


@dataclass(frozen=True)
class ServoAxis(Strict):
    """One position-controlled joint of the arm; every feature is absent by default.

    Args:
        limits: range [rad]. length, mass: of its link, a slender rod [m, kg].
        delay, rate_limit, time_constant: of the servo [s, rad/s, s].
        standing_error: distance at which the drive stops before its target, from either side (friction/stiffness) [rad].
        backlash: full width behind the drive [rad].
        compliance: sag per gravity moment [rad/(N·m)].
        eccentricity, teeth: amplitude [rad] of the error of an eccentric gear, and its periods per turn.
    """

    name: str
    limits: tuple[float, float]
    length: float
    mass: float
    delay: float = 0.0
    rate_limit: float = math.inf
    time_constant: float = 0.0
    standing_error: float = 0.0
    backlash: float = 0.0
    compliance: float = 0.0
    eccentricity: float = 0.0
    teeth: float = 12.0


@dataclass(frozen=True)
class Take(Strict):
    """One recording [s]."""

    name: str
    seed: int
    seconds: float


@dataclass(frozen=True)
class ServoArm(Strict):
    """The arm; ``noise`` is that of every joint sensor [rad], ``rate`` of the log [Hz]."""

    kind: Literal["servo_arm"]
    name: str
    seed: int
    axes: tuple[ServoAxis, ...]
    recordings: tuple[Take, ...]
    rate: float = 100.0
    noise: float = 0.0


@dataclass(frozen=True)
class Slide(Strict):
    """A carriage moved by a force; M·a = u − friction(v) − offset.

    Args:
        mass [kg], coulomb [N], viscous [N·s/m], static: break-away force [N], 0 = as sliding; stribeck: [m/s].
        bristle: elastic deflection of the seals before they slide [m]; 0 = rigid.
        offset: constant force against positive motion [N].
        cogging, pitch: amplitude [N] and period [m] of the cogging force of the motor.
        stiffness, damping, force_limit: of the position controller [N/m, N·s/m, N].
        stroke: half of its travel [m]; noise, force_noise: of the sensors [m, N].
    """

    kind: Literal["slide"]
    name: str
    seed: int
    mass: float
    recordings: tuple[Take, ...]
    coulomb: float = 0.0
    viscous: float = 0.0
    static: float = 0.0
    stribeck: float = 0.01
    bristle: float = 0.0
    offset: float = 0.0
    cogging: float = 0.0
    pitch: float = 0.03
    stiffness: float = 3e4
    damping: float = 1.5e3
    force_limit: float = 1.5e3
    stroke: float = 0.2
    rate: float = 1000.0
    noise: float = 0.0
    force_noise: float = 0.0
