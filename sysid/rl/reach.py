"""Where a machine can go: joint limits of the structure, and end effectors drawn from within them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.plant.model import Model, compile_plant
from sysid.rl.motion import stands

Array = npt.NDArray[np.float64]

#: Poses from which the box around all end effectors is taken.
_POSES = 4096


@dataclass(frozen=True)
class Reach:
    """Joint limits and the box of end effectors.

    Args:
        low, high: of the joints, (A,) [rad or m]: the narrowest of URDF, stroke of the cylinder and end stops.
        taught_low, taught_high: within them, what the forward model has seen, (A,); starts and targets come from there.
        ee_low, ee_high: box around the end effectors of these, (3,) [m].
    """

    low: Array
    high: Array
    taught_low: Array
    taught_high: Array
    ee_low: Array
    ee_high: Array

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Joints at random, (count, A)."""
        return rng.uniform(self.taught_low, self.taught_high, (count, len(self.low)))


def reach_of(plant: Plant, forward: ForwardModel | None = None) -> Reach:
    """The reach of a plant, within what ``forward`` was fitted on.

    Raises:
        SettingsError: a joint without limits, a cylinder without linkage, or a forward model that saw nothing of the range.
    """
    where = f"plant {plant.reference or plant.machine.name}"
    low, high = joint_limits(plant)
    taught_low, taught_high = low.copy(), high.copy()
    if forward is not None:
        taught_low, taught_high = np.maximum(low, forward.low), np.minimum(high, forward.high)
        for name, first, last in zip(plant.machine.axis_names, taught_low, taught_high, strict=True):
            if not first < last:
                found = f"the forward model saw no value of {name}.joint within its limits"
                raise SettingsError(where, found, "a forward model of this machine", "Fit it on poses of the whole range.")
    poses = np.random.default_rng(0).uniform(taught_low, taught_high, (_POSES, len(low)))
    ends = tips(compile_plant(plant), poses)
    return Reach(low, high, taught_low, taught_high, ends.min(axis=0), ends.max(axis=0))


def joint_limits(plant: Plant) -> tuple[Array, Array]:
    """Lower and upper limits of the joints, (A,) each: those of the URDF, and where the ends of the stroke lie.

    Raises:
        SettingsError: a joint without limits, or a cylinder without linkage.
    """
    where = f"plant {plant.reference or plant.machine.name}"
    low, high = np.empty(len(plant.machine.axes)), np.empty(len(plant.machine.axes))
    for i, axis in enumerate(plant.machine.axes):
        low[i], high[i] = axis.limits or (-np.inf, np.inf)
        if axis.drives == "cylinder" and axis.stroke is not None:
            if axis.name not in plant.linkages:
                expected = "geometry in machine.toml or a fitted actuator network"
                raise SettingsError(where, f"axis {axis.name} has no linkage", expected)
            ends = np.sort(plant.linkages[axis.name].joint(np.array(axis.stroke)))
            low[i], high[i] = max(low[i], ends[0]), min(high[i], ends[1])
        if not (np.isfinite(low[i]) and np.isfinite(high[i])):
            raise SettingsError(where, f"joint of axis {axis.name} has no limits", "limits in machine.toml or its URDF")
    return low, high


def tips(model: Model, joints: Array) -> Array:
    """End effectors of the plant, as measured, at rest at joints as their sensors read them, (n, A) → (n, 3) [m]."""
    out = np.empty((len(joints), 3))
    stands(model.theta, model.arrays, np.ascontiguousarray(joints, dtype=np.float64), out)
    return out
