"""The machine: its description, its kinematics, its linkages."""

from sysid.machine.description import (
    Axis,
    Convention,
    EffectKey,
    KnownEffect,
    Linkage,
    Machine,
    load_machine,
    machine_from_files,
)
from sysid.machine.kinematics import Kinematics
from sysid.machine.linkage import CylinderJointMap, TabulatedLinkage, TriangleLinkage, tabulate

__all__ = [
    "Axis",
    "Convention",
    "CylinderJointMap",
    "EffectKey",
    "Kinematics",
    "KnownEffect",
    "Linkage",
    "Machine",
    "TabulatedLinkage",
    "TriangleLinkage",
    "load_machine",
    "machine_from_files",
    "tabulate",
]
