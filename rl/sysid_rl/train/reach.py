"""The reach of a machine: joint limits of the structure, and random joints within them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.plant.model import Model, compile_plant
from sysid.plant.plant import LINKAGE
from sysid_rl.train.motion import resting_tips

Array = npt.NDArray[np.float64]

#: Poses for the bounding box of the end effectors.
_POSES = 4096


@dataclass(frozen=True)
class Reach:
    """Joint limits and the box of end effectors.

    Args:
        low, high: of the joints, (A,) [rad or m]: the narrowest of URDF, stroke of the cylinder and end stops.
        trained_low, trained_high: within them, the training range of the forward model, (A,), for starts and targets.
        ee_low, ee_high: bounding box of the end effectors of these, (3,) [m].
    """

    low: Array
    high: Array
    trained_low: Array
    trained_high: Array
    ee_low: Array
    ee_high: Array

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Random joints, (count, A)."""
        return rng.uniform(self.trained_low, self.trained_high, (count, len(self.low)))


def reach_of(plant: Plant, forward: ForwardModel | None = None) -> Reach:
    """The reach of a plant, within the training range of ``forward``.

    Raises:
        SettingsError: a joint without limits, a cylinder without linkage, or a forward model without data inside the limits.
    """
    where = f"plant {plant.reference or plant.machine.name}"
    low, high = joint_limits(plant)
    trained_low, trained_high = low.copy(), high.copy()
    if forward is not None:
        trained_low, trained_high = np.maximum(low, forward.low), np.minimum(high, forward.high)
        for name, first, last in zip(plant.machine.axis_names, trained_low, trained_high, strict=True):
            if not first < last:
                found = f"the forward model has no training data for {name}.joint within its limits"
                raise SettingsError(where, found, "a forward model of this machine", "Fit it on poses of the whole range.")
    poses = np.random.default_rng(0).uniform(trained_low, trained_high, (_POSES, len(low)))
    ends = tips(compile_plant(plant), poses)
    return Reach(low, high, trained_low, trained_high, ends.min(axis=0), ends.max(axis=0))


def joint_limits(plant: Plant) -> tuple[Array, Array]:
    """Lower and upper limits of the joints, (A,) each: the narrower of URDF and stroke.

    Raises:
        SettingsError: a joint without limits, or a cylinder without linkage.
    """
    where = f"plant {plant.reference or plant.machine.name}"
    low, high = np.empty(len(plant.machine.axes)), np.empty(len(plant.machine.axes))
    for i, axis in enumerate(plant.machine.axes):
        low[i], high[i] = axis.limits or (-np.inf, np.inf)
        if axis.drives == "cylinder" and axis.stroke is not None:
            if axis.name not in plant.linkages:
                raise SettingsError(where, f"axis {axis.name} has no linkage", LINKAGE)
            ends = np.sort(plant.linkages[axis.name].joint(np.array(axis.stroke)))
            low[i], high[i] = max(low[i], ends[0]), min(high[i], ends[1])
        if not (np.isfinite(low[i]) and np.isfinite(high[i])):
            raise SettingsError(where, f"joint of axis {axis.name} has no limits", "limits in machine.toml or its URDF")
    return low, high


def tips(model: Model, joints: Array) -> Array:
    """Measured end effectors of the plant at rest at measured joints, (n, A) → (n, 3) [m]."""
    out = np.empty((len(joints), 3))
    resting_tips(model.theta, model.arrays, np.ascontiguousarray(joints, dtype=np.float64), out)
    return out
