"""What another tool's description says about a machine, in the terms of ``machine.toml``."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from sysid.errors import SettingsError
from sysid.foreign import shown
from sysid.machine.description import RESERVED, Actuation, KnownEffect
from sysid.names import listed

#: Rate of the even grid of a drafted machine by actuation [Hz]; the user sets it to about the rate of the fastest log.
RATES: Mapping[Actuation, float] = {"position": 50.0, "velocity": 50.0, "force": 500.0}
#: Ends of a joint that has none, so that they can be written [rad, m].
WITHOUT_STOPS = {"revolute": 6.283, "prismatic": 1.0}


@dataclass(frozen=True)
class AxisDraft:
    """One axis; ``about`` is where its numbers come from.

    Args:
        gain: speed at command 1.0 [m/s or rad/s], of a velocity axis.
        inertia: of the rotor, or of all that moves where the URDF has no masses [kg or kg·m²], of a force axis.
        limits: [rad or m]; None: those of the URDF.
        effects: what its nominal simulation contains.
    """

    name: str
    joint: str
    actuation: Actuation
    about: str
    gain: float = 1.0
    inertia: float | None = None
    limits: tuple[float, float] | None = None
    effects: tuple[KnownEffect, ...] = ()


@dataclass(frozen=True)
class MachineDraft:
    """A machine, its URDF, and in ``notes`` what the description contains that ``machine.toml`` does not."""

    source: str
    axes: tuple[AxisDraft, ...]
    urdf: str
    tip: str
    tool: str | None = None
    notes: tuple[str, ...] = ()

    @property
    def rate_hz(self) -> float:
        return max(RATES[axis.actuation] for axis in self.axes)


def summarised(notes: Iterable[tuple[str, str]]) -> list[str]:
    """Pairs of a kind of part and the name of one → a line for each kind, with all its names."""
    found: dict[str, list[str]] = {}
    for kind, name in notes:
        found.setdefault(kind, []).append(name)
    return [f"{kind} {listed(list(dict.fromkeys(names)))}" for kind, names in found.items()]


def axis_names(joints: Collection[str], where: object) -> dict[str, str]:
    """Joint → name of its axis: its own name, with ``_`` for letters that a signal cannot have.

    Raises:
        SettingsError: two joints would have one name.
    """
    found: dict[str, str] = {}
    for joint in joints:
        name = "".join(letter if letter.isalnum() or letter in "_-" else "_" for letter in joint)[:64]
        name = f"{name}_axis" if name in RESERVED else name
        if name in found.values():
            raise SettingsError(
                where, f"joint {shown(joint)}: the axis name {name!r} is taken", "joints with names of their own"
            )
        found[joint] = name
    return found


def choose_tip(moved: Mapping[str, tuple[str, ...]], where: object) -> tuple[str, ...]:
    """The joints of the tip: the longest chain of a tree.

    Args:
        moved: end of a branch → driven joints from the base to it.

    Raises:
        SettingsError: several chains are equally long, or no joint is driven.
    """
    longest = max((len(joints) for joints in moved.values()), default=0)
    if longest == 0:
        raise SettingsError(where, "no driven joint", "a robot with actuators on its joints")
    chains = {joints: end for end, joints in moved.items() if len(joints) == longest}
    if len(chains) > 1:
        ends = ", ".join(sorted(chains.values()))
        found = f"{len(chains)} chains of {longest} driven joints, to {ends}"
        raise SettingsError(where, found, "one machine", f"Choose its end effector, such as --tip {min(chains.values())}.")
    return next(iter(chains))
