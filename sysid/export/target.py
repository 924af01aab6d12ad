"""What every export target offers: how it represents each effect, its files, and a simulation of them for the replay."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, get_args

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_data import WITHOUT_PART
from sysid.export.names import MachineNames
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
SupportKind = Literal["native", "composed", "plugin", "not_representable"]
KINDS: tuple[SupportKind, ...] = get_args(SupportKind)


@dataclass(frozen=True)
class Support:
    """How a target represents an effect.

    Args:
        kind: ``native``: the format has it; ``composed``: of several elements of the format; ``plugin``: by the drive model
            that ships with the file; ``not_representable``: the export lacks it.
        how: the element or file, or the reason.
    """

    kind: SupportKind
    how: str


@dataclass(frozen=True)
class Start:
    """State from which a replay begins, (A,) each.

    Args:
        joints: at their sensors; ``drive``: positions of the drives [rad or m].
        commands: held since long before.
        speeds: of the drives of force axes [rad/s or m/s]; zero for other axes, which move as their commands make them.
    """

    joints: Array
    drive: Array
    commands: Array
    speeds: Array


class Simulation(Protocol):
    """A written export in its simulator. Both methods return true signals by name (:mod:`sysid.signals`), in SI units."""

    def reset(self, start: Start) -> Mapping[str, float]: ...

    def step(self, commands: Array) -> Mapping[str, float]:
        """Advance by one sample; the commands are those of :func:`sysid.plant.stepper.step_commands`."""
        ...


class ForceSimulation(Protocol):
    """A written arm in its simulator. Its motion under recorded forces is unstable, so that its forces are compared."""

    def run(self, joints: Array, speeds: Array, commands: Array) -> tuple[Array, Array, Array]:
        """Motion from joints and speeds (A,) under commands (n, A), each held for a sample.

        Returns:
            Joints, speeds and accelerations (n, A) at the ends of the samples, under the command of the sample.
        """
        ...

    def forces(self, joints: Array, speeds: Array, accelerations: Array) -> Array:
        """Commands that a motion at the joint sensors needs: (n, A) each → (n, A)."""
        ...

    def tips(self, joints: Array) -> Array:
        """End effector (n, 3) [m] at joints (n, A)."""
        ...


class Target(ABC):
    """A format of another simulator.

    Attributes:
        name: as in ``sysid export --to NAME``.
        title: of the simulator, for people.
        modules: that it needs beside the core (:mod:`sysid.extras`).
        notes: on its use, for the page of an export.
        resolution: relative rounding of its coarsest numbers, zero for those of 64 bits.
        arms: whether it writes force axes that move links with masses; its simulation of them is a :class:`ForceSimulation`.
        native, composed, plugin, not_representable: effect → element or file, or the reason, by :data:`SupportKind`.
    """

    name: str
    title: str
    modules: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    resolution = 0.0
    arms = False
    native: Mapping[str, str] = {}
    composed: Mapping[str, str] = {}
    plugin: Mapping[str, str] = {}
    not_representable: Mapping[str, str] = WITHOUT_PART

    def support(self, effect: Effect) -> Support:
        """How it represents an effect."""
        for kind in KINDS:
            if effect.name in (table := getattr(self, kind)):
                return Support(kind, table[effect.name])
        return self.otherwise(effect)

    @abstractmethod
    def otherwise(self, effect: Effect) -> Support:
        """How it represents an effect that is in none of its tables."""

    @abstractmethod
    def names(self, plant: Plant) -> MachineNames:
        """Names of the parts of the machine in its files."""

    @abstractmethod
    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        """Write the files into an existing folder; returns their names, the main one first.

        Raises:
            SettingsError: the target cannot represent this machine.
        """

    @abstractmethod
    def simulation(self, plant: Plant, folder: Path) -> Simulation | ForceSimulation | None:
        """The files in their simulator; None where it cannot run here."""
