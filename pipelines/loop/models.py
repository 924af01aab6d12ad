"""Versions that control the machine: the plant, and the forward model of its kinematics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import qmc

from sysid.gap import GapResult
from sysid.machine import KnownEffect
from sysid.networks import Geometry, StructuredForward, calibrate, to_files
from sysid.plant import Plant
from sysid.registry import Registry
from sysid_rl.train.inverse_kinematics import chain_of_plant
from sysid_rl.train.reach import joint_limits

#: Poses of the plant from which its forward model is calibrated.
POSES = 512


def forward_of(plant: Plant) -> StructuredForward:
    """Joints → boom tip of a plant, calibrated on poses of its kinematics.

    Raises:
        SettingsError: its machine has no URDF.
    """
    machine = plant.machine
    kinematics = machine.kinematics()
    assert kinematics is not None
    low, high = joint_limits(plant)
    joints = qmc.scale(qmc.Sobol(len(low), seed=0).random(POSES), low, high)
    tips = chain_of_plant(plant).predict(joints)
    unknown = np.full(len(low), np.nan), np.full(3, np.nan)
    found = calibrate(Geometry(kinematics), joints, tips, *unknown, elastic=False)
    signals = tuple(f"{axis.name}.joint" for axis in machine.axes)
    turning = tuple(not kinematics.joints[axis.joint].prismatic for axis in machine.axes)
    return StructuredForward(
        joints=signals, revolute=turning, members=(), low=low, high=high,
        structure=found, urdf=machine.urdf_text or "", bound=0.0,
    )  # fmt: skip


def register_forward(registry: Registry, plant: Plant) -> str:
    """The forward model of a registered plant as a version."""
    kind, files = to_files(forward_of(plant))
    lineage = {"plant": plant.reference, "machine": plant.machine.name}
    return registry.register(f"{plant.machine.name}-forward", kind, files, lineage, {}).reference


def named_part(repaired: Plant, gap: GapResult) -> Plant:
    """The repaired plant without what the gap workflow adjusted or could not distinguish: named effects only.

    An adjusted effect that stays in the plant cannot be named by a later round, since its error is gone, and one that only
    compensates for another effect's formula need not hold on another motion.
    """
    for item in gap.written:
        if item.kind == "named":
            continue
        if item.before:
            before = {key: _plain(value) for key, value in item.before.items()}
            repaired = repaired.with_effect(KnownEffect(item.name, item.target, before, item.side))
        else:
            repaired = repaired.without_effect(item.name, item.target, item.side)
    return repaired


def _plain(value: Any) -> float | list[float]:
    return [float(each) for each in value] if np.ndim(value) else float(value)


def register_plant(registry: Registry, plant: Plant, lineage: Mapping[str, str]) -> str:
    """A plant as a version, with its sources."""
    sources = {"machine": plant.machine.name, **lineage}
    return registry.register(plant.machine.name, "plant", plant.to_files(), sources, {}).reference
