"""The list of export targets."""

from __future__ import annotations

from sysid.errors import SettingsError, nearest
from sysid.export.fmu import FmuTarget
from sysid.export.isaaclab import IsaacLabTarget
from sysid.export.json_target import JsonTarget
from sysid.export.lut import LutTarget
from sysid.export.mjcf import MjcfTarget
from sysid.export.newton import NewtonTarget
from sysid.export.sdf import SdfTarget
from sysid.export.simulink import SimulinkTarget
from sysid.export.target import Target
from sysid.export.urdf import UrdfTarget
from sysid.machine.rigid_body import moves_masses
from sysid.plant import Plant

TARGETS: tuple[Target, ...] = (
    MjcfTarget(), UrdfTarget(), SdfTarget(), IsaacLabTarget(), NewtonTarget(), FmuTarget(), SimulinkTarget(), LutTarget(),
    JsonTarget(),
)  # fmt: skip


def target_named(name: str) -> Target:
    """The target of ``sysid export --to NAME``.

    Raises:
        SettingsError: no target has that name.
    """
    names = [target.name for target in TARGETS]
    if name not in names:
        raise SettingsError("sysid export", f"no target {name!r}", nearest(name, names))
    return TARGETS[names.index(name)]


def fallback(target: Target, plant: Plant) -> Target | None:
    """A variant that leaves more to the drive model, for an export that does not agree with the plant; None without."""
    if not isinstance(target, MjcfTarget) or target.most == "plugin" or moves_masses(plant.machine):
        return None
    return MjcfTarget("native" if target.most == "composed" else "plugin")
