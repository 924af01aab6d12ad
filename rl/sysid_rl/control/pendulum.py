"""The hanging tool as a pendulum below the boom tip: its frequency, and the tip path that leads the tool along a given path.

Equation of ``gripper_sway`` for small angles, in both horizontal directions (d: tool relative to the tip, a: of the tip)::

    d̈ + 2ζω₀·ḋ + ω₀²·d = −a        ω₀² = g/L

The tool position is a flat output of this system (Fliess et al. 1995): from a smooth path of the tool the path of the tip
follows without integration. Without damping the string points along the specific force of the tool. With tool p and length L::

    tip = p + L·(p̈ + g·e_z)/‖p̈ + g·e_z‖
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.effects import gripper_sway
from sysid.errors import SettingsError
from sysid.machine.kinematics import GRAVITY
from sysid.plant import Plant

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Pendulum:
    """A tool on a string.

    Args:
        length: from pivot to tool [m].
        damping_ratio: ζ of its swing.
    """

    length: float
    damping_ratio: float

    @property
    def frequency(self) -> float:
        """Natural frequency ω₀ [rad/s]."""
        return math.sqrt(GRAVITY / self.length)

    @property
    def period(self) -> float:
        """Period of the damped swing [s]."""
        return 2.0 * math.pi / (self.frequency * math.sqrt(1.0 - self.damping_ratio**2))

    def tip_path(self, tool: npt.ArrayLike, rate_hz: float) -> Array:
        """Tip positions (n, 3) [m] whose hanging tool, undamped, follows ``tool`` (n, 3) [m], which begins and ends at rest.

        Accelerations are second differences of the samples.
        """
        points = np.asarray(tool, dtype=np.float64)
        padded = np.concatenate([points[:1], points, points[-1:]])
        pull = np.diff(padded, 2, axis=0) * rate_hz**2
        pull[:, 2] += GRAVITY
        return np.asarray(points + self.length * pull / np.linalg.norm(pull, axis=1, keepdims=True))


def pendulum_of(plant: Plant) -> Pendulum:
    """The pendulum of a plant's ``gripper_sway``.

    Raises:
        SettingsError: the plant has none.
    """
    effect = plant.effect(gripper_sway.EFFECT.name, "tool")
    if effect is None:
        found = "no gripper_sway: the frequency of the tool is not known"
        remedy = "Identify it: sysid gap … --add on recordings with a measured tool."
        raise SettingsError(f"plant {plant.reference or plant.machine.name}", found, "a plant with a hanging tool", remedy)
    length, damping = (float(np.atleast_1d(effect.parameters[name])[0]) for name in ("length", "damping_ratio"))
    return Pendulum(length, damping)
