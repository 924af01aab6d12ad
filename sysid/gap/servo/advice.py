"""What to record where sag under a load and an error of the sensor cannot be distinguished."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.effects import joint_compliance, sensor_bias
from sysid.machine import Machine
from sysid.machine.moved_bodies import has_masses
from sysid.names import listed


def sagging_axis(tie: Sequence[tuple[str, str]], machine: Machine) -> str:
    """The position axis that such a tie is about, its load not known; empty for other ties."""
    axes = [target for name, target in tie if name == joint_compliance.EFFECT.name]
    biased = any(name == sensor_bias.EFFECT.name for name, _ in tie)
    if not axes or not biased or machine.axis(axes[0]).actuation != "position":
        return ""
    kinematics = machine.kinematics()
    if kinematics is not None and has_masses(kinematics):
        return ""
    return axes[0]


def advice_on_sag(axes: Sequence[str]) -> str:
    """What would distinguish the two on these axes."""
    return (
        f"Gravity of {listed(list(axes))}: give the masses (urdf, tip and the joint of each axis in machine.toml). Or record "
        "the same postures at rest with a known weight at the tip and without: sag under the load changes with the weight, an "
        "error of the sensor does not."
    )
