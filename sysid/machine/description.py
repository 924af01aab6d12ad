"""``machine.toml``: axes, linkages, sensor noise and known effects of a machine."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from sysid.config import Strict, inside, parse_settings, settings_text, toml_values
from sysid.errors import SettingsError, nearest
from sysid.foreign import shown
from sysid.machine.kinematics import GRAVITY, Kinematics
from sysid.machine.moved_bodies import has_masses
from sysid.machine.urdf_tree import indefinite_links
from sysid.names import check_file_name
from sysid.numbers import Finite, Gravity, Interval, NonNegative, Positive, Rate, interval
from sysid.signals import canonical_signals, split_signal

Actuation = Literal["velocity", "position", "force", "servo"]
#: Order of command and sample in a row of the recordings. ``read_before_written``: the command acts after the sample of its row
#: was read, so that the next row shows it first. ``written_before_read``: it has acted for a period when the sample is read.
Convention = Literal["read_before_written", "written_before_read"]
Drives = Literal["cylinder", "joint"]
#: Kind of drive of an axis: see :meth:`Machine.drive_of`.
Drive = Literal["hydraulic", "electric", "unknown"]
#: Least inertia of an axis that moves no masses of a URDF [kg or kg·m²].
LEAST_INERTIA = 1e-12
#: Names that neither an axis nor a marker may have.
RESERVED = ("ee", "tool", "machine", "base", "time")
_LETTERS = "letters, digits, '_' and '-', at most 64"


@dataclass(frozen=True)
class Linkage(Strict):
    """A cylinder between two levers that meet at the joint (triangle).

    ``length² = a² + b² − 2ab·cos(sense·(q + offset))``, ``displacement = length − retracted``.

    Args:
        a, b: lever lengths [m].
        offset: angle between the levers at joint zero [rad].
        retracted: length at zero displacement [m].
        sense: −1 for a cylinder that shortens as the joint angle rises.
    """

    kind: Literal["triangle"]
    a: Positive
    b: Positive
    offset: Finite
    retracted: NonNegative
    sense: Literal[1, -1] = 1


@dataclass(frozen=True)
class ServoLaw(Strict):
    """The controller of a servo axis: ``force = clip(kp·(command − q) − kv·q̇, low, high)``.

    Args:
        kp: force per error of position [N·m/rad or N/m].
        kv: force per speed [N·m·s/rad or N·s/m].
        force_limit: largest magnitude, or [lo, hi] around zero [N·m or N]; without it the force has no limit.
        step: time step of the simulator that makes the motion [s]; 0 for a machine.
        implicit: whether its step takes kv at the speed after it (MuJoCo: ``implicit``, ``implicitfast``; not ``Euler``).
        friction_give: dry friction of the simulator is a constraint that gives way: below its largest force, a joint creeps at
            so much speed a force [rad/(s·N·m) or m/(s·N)]; 0: dry friction holds.
        friction_time: time in which it gives way [s].

    Source: MuJoCo 3, *XML Reference*, ``actuator/position``.
    """

    kp: Positive
    kv: NonNegative = 0.0
    force_limit: Positive | Interval | None = None
    step: NonNegative = 0.0
    implicit: bool = True
    friction_give: NonNegative = 0.0
    friction_time: NonNegative = 0.0

    @property
    def force_range(self) -> tuple[float, float]:
        """Lowest and highest force [N·m or N]; infinite without a limit."""
        if self.force_limit is None:
            return -math.inf, math.inf
        return self.force_limit if isinstance(self.force_limit, tuple) else (-self.force_limit, self.force_limit)


@dataclass(frozen=True)
class Axis(Strict):
    """One actuated joint; ``gain`` is the speed of the driven signal at command 1.0 [m/s or rad/s].

    Args:
        joint_type: as in a URDF; without both, units of the logs or the recipe decide.
        inertia: of what a force axis moves, or of the rotor of a servo axis (armature) [kg or kg·m²].
        servo: the controller of a servo axis.
        estimated: keys whose values are from logs, not from knowledge, or left out: a better value is not reported as a missing
            effect.
    """

    name: str
    actuation: Actuation
    drives: Drives
    joint: str | None = None
    joint_type: Literal["revolute", "prismatic"] | None = None
    gain: Positive = 1.0
    inertia: NonNegative | None = None
    stroke: Interval | None = None
    limits: Interval | None = None
    linkage: Linkage | None = None
    servo: ServoLaw | None = None
    estimated: tuple[Literal["gain", "inertia"], ...] = ()

    @property
    def follows_positions(self) -> bool:
        """Whether its command is a position of what it drives: of a servo, by its response or by its controller."""
        return self.actuation in ("position", "servo")

    @property
    def driven(self) -> str:
        """The signal that the command moves: ``<axis>.cylinder`` or ``<axis>.joint``."""
        return f"{self.name}.{self.drives}"

    @property
    def range(self) -> tuple[float, float]:
        """End stops of the driven signal [m or rad]; infinite if not given."""
        ends = self.stroke if self.drives == "cylinder" else self.limits
        return ends if ends is not None else (-math.inf, math.inf)


#: What all forms of an effect at one place share: name, target, side.
EffectKey = tuple[str, str, str | None]


@dataclass(frozen=True)
class KnownEffect(Strict):
    """An effect that the nominal simulation already contains."""

    name: str
    target: str
    parameters: dict[str, float | list[float]] = field(default_factory=dict)
    side: Literal["drive", "structure"] | None = None


@dataclass(frozen=True)
class Machine(Strict):
    """A machine description, built by :func:`load_machine`.

    Args:
        gravity: along −z of the URDF's root link [m/s²].
        convention: of all recordings; None: not known, taken as ``read_before_written``.
        left_out: what the description that it was drafted from contains beyond it, such as force limits.
        markers: name → URDF link that carries it, of points measured beside the end effector: signals ``<name>.x`` ….
        text, urdf_text: its source files, which a dataset version stores.
    """

    schema: Literal[1]
    name: str
    rate_hz: Rate
    axes: tuple[Axis, ...]
    urdf: str | None = None
    tip: str | None = None
    tool: str | None = None
    gravity: Gravity = GRAVITY
    markers: dict[str, str] = field(default_factory=dict)
    noise: dict[str, NonNegative] = field(default_factory=dict)
    effects: tuple[KnownEffect, ...] = ()
    left_out: tuple[str, ...] = ()
    convention: Convention | None = None
    text: str = ""
    urdf_text: str | None = None

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.axes)

    @property
    def signals(self) -> tuple[str, ...]:
        """Every signal name that a log of this machine may have."""
        return canonical_signals(self.axis_names, tuple(self.markers))

    def axis(self, name: str) -> Axis:
        if name not in self._by_name:
            raise SettingsError(f"machine {self.name}", f"unknown axis {name!r}", nearest(name, self.axis_names))
        return self._by_name[name]

    def command_shift(self, name: str) -> int:
        """Rows by which the commands of recordings are moved for the plant: later (1), not at all (0) or earlier (−1).

        The plant takes the command of a position axis as written before its sample is read, the others as read before.
        """
        return int(self.axis(name).actuation == "position") - int(self.convention == "written_before_read")

    def has_axis(self, name: str) -> bool:
        return name in self._by_name

    @cached_property
    def _by_name(self) -> dict[str, Axis]:
        return {axis.name: axis for axis in self.axes}

    def by_responses(self) -> Machine:
        """The machine for effects around a simulator that has the controllers itself: servo axes as position axes.

        It has no effects where it has servo axes, since those describe the inside of the simulator.
        """
        if all(axis.servo is None for axis in self.axes):
            return self
        axes = (replace(axis, actuation="position", servo=None, inertia=None) for axis in self.axes)
        return replace(self, axes=tuple(axes), effects=())

    def drive_of(self, name: str) -> Drive:
        """The kind of drive of an axis.

        A cylinder is hydraulic; a joint that follows positions or forces is electric. A joint that is commanded by its speed is
        hydraulic on a machine with cylinders, else either.
        """
        axis = self.axis(name)
        if axis.drives == "cylinder":
            return "hydraulic"
        if axis.actuation != "velocity":
            return "electric"
        return "hydraulic" if any(other.drives == "cylinder" for other in self.axes) else "unknown"

    def kinematics(self) -> Kinematics | None:
        """The chain of the URDF from its root to ``tip``; None without a URDF."""
        if self.urdf_text is None or self.tip is None:
            return None
        joints = tuple(axis.joint or "" for axis in self.axes)
        return Kinematics.from_urdf(self.urdf_text, joints=joints, tip=self.tip, tool=self.tool, gravity=self.gravity)

    def expected_unit(self, signal: str) -> str | None:
        """SI unit of ``signal``; None if it may be rad or m (a joint without a URDF), or the rate of either."""
        owner, quantity = split_signal(signal)
        if owner in ("ee", "tool", *self.markers) or quantity == "cylinder":
            return "m"
        axis = self.axis(owner)
        joint_unit = self._joint_unit(axis)
        if quantity == "joint":
            return joint_unit
        if quantity == "speed":
            return "m/s" if axis.drives == "cylinder" else f"{joint_unit}/s" if joint_unit is not None else None
        if axis.actuation == "velocity":
            return "1"
        if axis.actuation == "force":
            return {"rad": "N·m", "m": "N"}.get(joint_unit or "") if axis.drives == "joint" else "N"
        return joint_unit if axis.drives == "joint" else "m"

    def _joint_unit(self, axis: Axis) -> str | None:
        kinematics = self.kinematics()
        if kinematics is not None and axis.joint is not None:
            return "m" if kinematics.is_prismatic(axis.joint) else "rad"
        return {"revolute": "rad", "prismatic": "m", None: None}[axis.joint_type]

    def files(self) -> dict[str, str]:
        """File name → text, for :func:`machine_from_files`."""
        files = {"machine.toml": self.text}
        if self.urdf is not None and self.urdf_text is not None:
            files[self.urdf] = self.urdf_text
        return files


def load_machine(path: Path, unfinished: bool = False) -> Machine:
    """Read and check ``machine.toml``; ``unfinished``: the strokes of cylinders may be missing.

    Raises:
        SettingsError: an unknown key, a missing file, a name that does not exist, a linkage that does not close.
    """
    text = settings_text(path)
    values = toml_values(text, path)
    urdf_text = None
    if isinstance(values.get("urdf"), str):
        urdf_path = inside(path.parent, values["urdf"], f"{path}: urdf")
        if not urdf_path.is_file():
            raise SettingsError(f"{path}: urdf", f"no such file {values['urdf']!r}", "a URDF file relative to machine.toml")
        urdf_text = settings_text(urdf_path, "a URDF file")
    return _build(values, text, urdf_text, path, unfinished)


def machine_from_files(files: dict[str, str], where: object) -> Machine:
    """The machine of stored :meth:`Machine.files`.

    Raises:
        SettingsError: as :func:`load_machine`.
    """
    if "machine.toml" not in files:
        raise SettingsError(where, "no machine.toml", "the machine's description")
    values = toml_values(files["machine.toml"], f"{where}: machine.toml")
    urdf = values.get("urdf")
    return _build(values, files["machine.toml"], files.get(urdf) if isinstance(urdf, str) else None, where)


def _build(values: dict[str, Any], text: str, urdf_text: str | None, where: object, unfinished: bool = False) -> Machine:
    for key in ("text", "urdf_text"):
        if key in values:
            raise SettingsError(where, f"unknown key {key!r}", "the keys of machine.toml", "Remove it.")
    machine = parse_settings({**values, "text": text, "urdf_text": urdf_text}, Machine, where)
    machine = replace(machine, axes=tuple(map(_with_estimates, machine.axes, values["axes"])))
    _check_axes(machine, where, unfinished)
    if machine.urdf is not None:
        if urdf_text is None:
            raise SettingsError(f"{where}: urdf", f"no file {shown(machine.urdf)}", "the URDF beside machine.toml")
        for axis in machine.axes:  # before the kinematics are built, which need every name
            if axis.joint is None:
                raise SettingsError(f"{where}: axis {axis.name!r}", "no joint", 'joint = "<URDF joint>" where a urdf is given')
        machine = replace(machine, axes=tuple(_with_urdf_limits(machine, axis, where) for axis in machine.axes))
        _check_joint_types(machine, where)
    _check_servos(machine, where)
    _check_inertias(machine, where)
    _check_markers(machine, where)
    for signal in machine.noise:
        if signal not in machine.signals:
            raise SettingsError(f"{where}: noise", f"unknown signal {signal!r}", nearest(signal, machine.signals))
    _check_linkages(machine, where)
    return machine


def _with_estimates(axis: Axis, stated: Mapping[str, Any]) -> Axis:
    """A valve axis whose ``gain`` is left out has one that nobody knows."""
    if axis.actuation != "velocity" or "gain" in stated or "gain" in axis.estimated:
        return axis
    return replace(axis, estimated=(*axis.estimated, "gain"))


def _check_axes(machine: Machine, where: object, unfinished: bool) -> None:
    if not machine.axes:
        raise SettingsError(where, "no axes", "at least one [[axes]] entry")
    check_file_name(machine.name, f"{where}: name")
    names = Counter(machine.axis_names)
    for axis in machine.axes:
        place = f"{where}: axis {shown(axis.name)}"
        if not _is_name(axis.name):
            raise SettingsError(place, "a name that no signal can have", _LETTERS)
        if names[axis.name] > 1 or axis.name in RESERVED:
            raise SettingsError(place, "name is taken", "a name of its own for every axis")
        if axis.drives == "cylinder" and axis.stroke is None and not unfinished:
            expected = "stroke = [lo, hi] [m] for an axis that drives a cylinder"
            raise SettingsError(place, "no stroke", expected, "`sysid ingest --inspect LOGS` proposes it from the logs.")


def _check_inertias(machine: Machine, where: object) -> None:
    """A force or servo axis has an inertia; where the URDF gives the masses that it moves, that of its rotor, if known."""
    kinematics = machine.kinematics()
    massive = kinematics is not None and has_masses(kinematics)
    for axis in machine.axes:
        if axis.actuation not in ("force", "servo"):
            continue
        loaded = massive and axis.drives == "joint"
        if axis.inertia is None and not loaded:
            expected = f"inertia [kg or kg·m²] of what a {axis.actuation} axis moves, or a URDF with the masses of the links"
            raise SettingsError(f"{where}: axis {shown(axis.name)}", "no inertia", expected)
        if axis.inertia is not None and axis.inertia < LEAST_INERTIA and not (loaded and axis.actuation == "servo"):
            expected = f"at least {LEAST_INERTIA:g} kg or kg·m²"
            expected += ", or a URDF with the masses of the links" if axis.actuation == "servo" else ""
            raise SettingsError(f"{where}: axis {shown(axis.name)}: inertia", f"{axis.inertia:g}", expected)
    if massive and kinematics is not None and any(axis.actuation in ("force", "servo") for axis in machine.axes):
        assert machine.urdf_text is not None
        moved = kinematics.moved_links
        for link in indefinite_links(machine.urdf_text):
            if link in moved:
                expected = "moments of a body: all principal moments at least zero"
                remedy = "Correct it; all six moments 0 is a point mass."
                raise SettingsError(f"urdf: link {shown(link)}: inertia", "a negative principal moment", expected, remedy)


def _check_servos(machine: Machine, where: object) -> None:
    """A servo axis drives its joint by a controller, whose limits contain zero; all axes of its machine are servo axes."""
    for axis in machine.axes:
        place = f"{where}: axis {shown(axis.name)}"
        if axis.actuation != "servo":
            if axis.servo is not None:
                remedy = 'Remove it, or write actuation = "servo".'
                raise SettingsError(f"{place}: servo", f"a controller on a {axis.actuation} axis", "a servo axis", remedy)
            continue
        if axis.servo is None:
            expected = "servo = { kp = …, kv = …, force_limit = … }"
            remedy = 'Write it, or actuation = "position" where only the response of the servo is known.'
            raise SettingsError(place, "no controller", expected, remedy)
        if axis.drives != "joint":
            raise SettingsError(f"{place}: drives", repr(axis.drives), "'joint' on a servo axis")
        low, high = axis.servo.force_range
        if not low < 0.0 < high:
            raise SettingsError(f"{place}: servo.force_limit", f"[{low:g}, {high:g}]", "a range around zero [N·m or N]")
        for other in machine.axes:
            if other.actuation != "servo":
                found = f"a servo axis beside {shown(other.name)}, a {other.actuation} axis"
                remedy = 'Write actuation = "position" on this axis, or actuation = "servo" on all of them.'
                raise SettingsError(place, found, "a machine with servo axes only", remedy)


def _check_joint_types(machine: Machine, where: object) -> None:
    for axis in machine.axes:
        unit = machine.expected_unit(f"{axis.name}.joint")
        actual = "prismatic" if unit == "m" else "revolute"
        if axis.joint_type not in (None, actual):
            place = f"{where}: axis {shown(axis.name)}: joint_type"
            raise SettingsError(place, f"{axis.joint_type!r}", f"{actual!r} as joint {shown(axis.joint or '')} of the URDF")


def _check_markers(machine: Machine, where: object) -> None:
    kinematics = machine.kinematics()
    for name, link in machine.markers.items():
        place = f"{where}: markers: {shown(name)}"
        if not _is_name(name) or name in (*machine.axis_names, *RESERVED):
            raise SettingsError(
                place, "a name that no marker can have", f"{_LETTERS}, neither an axis nor {', '.join(RESERVED)}"
            )
        if kinematics is None:
            raise SettingsError(place, "a marker on a link", "a machine with a urdf")
        links = [kinematics.chain[0].parent, *(joint.child for joint in kinematics.chain)] if kinematics.chain else []
        if link not in links:
            raise SettingsError(place, f"link {shown(link)}, which is not between base and tip", nearest(link, links))


def _is_name(name: str) -> bool:
    return bool(name) and len(name) <= 64 and all(letter.isalnum() or letter in "_-" for letter in name)


def _with_urdf_limits(machine: Machine, axis: Axis, where: object) -> Axis:
    """The axis, with the limits of its URDF joint if the description gives none."""
    if machine.tip is None:
        raise SettingsError(where, "a urdf but no tip", 'tip = "<link>", the link whose origin is the end effector')
    kinematics = machine.kinematics()
    assert kinematics is not None
    assert axis.joint is not None
    if axis.limits is not None:
        return axis
    return replace(axis, limits=interval(*kinematics.limits(axis.joint), f"urdf: joint {axis.joint!r}: limit"))


def _check_linkages(machine: Machine, where: object) -> None:
    for axis in machine.axes:
        link = axis.linkage
        if link is None or axis.limits is None:
            continue
        low, high = sorted(link.sense * (q + link.offset) for q in axis.limits)
        if low < 0.0 or high > math.pi:
            raise SettingsError(
                f"{where}: axis {axis.name!r}: linkage",
                f"the lever angle runs from {low:.3f} to {high:.3f} rad over the joint limits",
                "a range inside [0, π], so that the map is one-to-one",
                "Correct offset, sense or the limits.",
            )
