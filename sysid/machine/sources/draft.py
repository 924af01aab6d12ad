"""What another tool's description says about a machine, in the terms of ``machine.toml``; and the text of ``machine.toml`` and
``recipe.toml`` for a drafted machine, with comments that explain each key.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from sysid.errors import SettingsError, UnknownDriveError
from sysid.machine.description import RESERVED, Actuation, KnownEffect, ServoLaw
from sysid.machine.kinematics import GRAVITY
from sysid.names import listed
from sysid.numbers import LARGEST
from sysid.quoting import comment, toml_key, toml_value

#: Rate of the even grid of a drafted machine by actuation [Hz]; the user sets it to about the rate of the fastest log.
RATES: Mapping[Actuation, float] = {"position": 50.0, "velocity": 50.0, "servo": 50.0, "force": 500.0}
#: ``--kind`` → what its commands are, and the actuation of every axis.
KINDS: Mapping[str, str] = {"servo": "positions", "hydraulic": "speeds", "force": "forces or torques"}
ACTUATIONS: Mapping[str, Actuation] = {"servo": "position", "hydraulic": "velocity", "force": "force"}
#: ``--kind`` of a machine whose servos are described by their responses, although the description states their controllers.
RESPONSE = "response"
#: Ends of a joint that has none, so that they can be written [rad, m].
WITHOUT_STOPS = {"revolute": 6.283, "prismatic": 1.0}


@dataclass(frozen=True)
class AxisDraft:
    """One axis; ``about`` is where its numbers come from.

    Args:
        gain: speed at command 1.0 [m/s or rad/s], of a velocity axis.
        assumed: what is written without a source.
        inertia: of the rotor, or of all that moves where the URDF has no masses [kg or kg·m²], of a force or servo axis.
        limits: [rad or m]; None: those of the URDF.
        effects: what its nominal simulation contains.
        servo: the controller of a servo axis.
    """

    name: str
    joint: str
    actuation: Actuation
    about: str
    gain: float = 1.0
    inertia: float | None = None
    limits: tuple[float, float] | None = None
    effects: tuple[KnownEffect, ...] = ()
    assumed: tuple[str, ...] = ()
    servo: ServoLaw | None = None


@dataclass(frozen=True)
class MachineDraft:
    """A machine and its URDF.

    Args:
        left_out: what the description contains beyond ``machine.toml``.
        assumed: what it does not state, with the assumption.
    """

    source: str
    axes: tuple[AxisDraft, ...]
    urdf: str
    tip: str
    tool: str | None = None
    left_out: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    gravity: float = GRAVITY

    @property
    def rate_hz(self) -> float:
        return max(RATES[axis.actuation] for axis in self.axes)


@dataclass(frozen=True)
class ChainChoice:
    """One machine that a description contains.

    Args:
        joints: driven ones from the base to the tip.
        path: links or bodies from the root to the end of the chain.
        tip: the end effector: a link, site or body behind them.
        base: what has to be fixed so that they are the first; None for the root.
        held: the joint in front of ``base``, for messages.
    """

    joints: tuple[str, ...]
    path: tuple[str, ...]
    tip: str
    base: str | None = None
    held: str = ""

    def options(self, kind: str | None = None) -> str:
        """The options of ``sysid init`` that choose it."""
        words = [("--base", self.base), ("--tip", self.tip), ("--kind", kind)]
        return " ".join(f"{key} {shlex.quote(value)}" for key, value in words if value is not None)


def summarised(notes: Iterable[tuple[str, str]]) -> list[str]:
    """Pairs of a kind of part and the name of one → a line for each kind, with all its names."""
    found: dict[str, list[str]] = {}
    for kind, name in notes:
        found.setdefault(kind, []).append(name)
    return [f"{kind} {listed(list(dict.fromkeys(names)))}" for kind, names in found.items()]


def axis_names(joints: Collection[str]) -> dict[str, str]:
    """Joint → name of its axis: its own name, with ``_`` for letters that a signal cannot have, numbered where it is taken."""
    found: dict[str, str] = {}
    for joint in joints:
        first = "".join(letter if letter.isalnum() or letter in "_-" else "_" for letter in joint)[:60] or "axis"
        first = f"{first}_axis" if first in RESERVED else first
        names = (first, *(f"{first}_{k}" for k in range(2, len(joints) + 2)))
        found[joint] = next(name for name in names if name not in found.values())
    return found


def stops(axis: str, low: float, high: float, prismatic: bool) -> tuple[tuple[float, float] | None, tuple[str, ...]]:
    """Limits to be written for a joint that lacks an end stop, None where it has both, and the assumption that they are."""
    most, unit = WITHOUT_STOPS["prismatic" if prismatic else "revolute"], "m" if prismatic else "rad"
    if math.isfinite(low) and math.isfinite(high):
        return None, ()
    if not math.isfinite(low):
        low = -most if not math.isfinite(high) else min(-most, high - most)
    if not math.isfinite(high):
        high = max(most, low + most)
    return (low, high), (f"end stops of {axis}: {low:g} and {high:g} {unit}",)


def limit_notes(joint: str, *limits: tuple[str, float, str]) -> list[tuple[str, str]]:
    """Limits of a drive that ``machine.toml`` does not contain: what it limits, value, unit; 0 is none."""
    return [(f"{of} limit {value:.6g} {unit} of", joint) for of, value, unit in limits if value > 0.0]


def known_effects(axis: str, *values: tuple[str, str, float]) -> list[KnownEffect]:
    """Effects of an axis: name, parameter and value of each; 0 is none."""
    return [KnownEffect(effect, axis, {parameter: value}) for effect, parameter, value in values if value > 0.0]


def draft_of(
    choices: Sequence[ChainChoice],
    draft: Callable[[ChainChoice, str | None], MachineDraft],
    at: Callable[[str], ChainChoice],
    where: str,
    kind: str | None,
) -> MachineDraft:
    """The machine of the longest chain.

    Where several chains are as long as that and have more than half of their joints in common, as the fingers of one hand, the
    machine ends in front of where they part.

    Args:
        choices: every end of a chain.
        draft: the machine of a choice for ``--kind`` or None.
        at: the choice that ends at a link or body.
        kind: as the user has chosen.

    Raises:
        SettingsError: no joint moves, several chains are equally long, or the first has to be held at its base. What is
            proposed in its place has been tried.
    """
    longest = max((len(choice.joints) for choice in choices), default=0)
    if longest == 0:
        raise SettingsError(
            where, "no joint that moves by itself", "a robot with hinges or slides (others are outside the scope)"
        )
    groups: dict[object, list[ChainChoice]] = {}
    for choice in choices:
        if len(choice.joints) == longest:
            groups.setdefault((choice.base, choice.joints[: longest // 2 + 1]), []).append(choice)
    found, assumed = list[ChainChoice](), list[str]()
    for group in groups.values():
        found.append(group[0])
        if len(group) > 1:
            common = [names[0] for names in zip(*(each.path for each in group), strict=False) if len({*names}) == 1]
            before = at(common[-1]) if common else group[0]
            found[-1] = before if 2 * len(before.joints) > longest else group[0]
            if found[-1].joints != group[0].joints or found[-1] is group[0]:
                ends = listed([each.tip for each in group], most=4)
                assumed.append(f"end effector {found[-1].tip}: the chain parts to {ends}; --tip chooses another")
    attempts = [_attempt(choice, draft, kind) for choice in found]
    if len(found) > 1 or found[0].base is not None:
        raise _proposal(attempts, where)
    if attempts[0].draft is None:
        raise attempts[0].refusal()
    return replace(attempts[0].draft, assumed=(*assumed, *attempts[0].draft.assumed))


@dataclass(frozen=True)
class _Attempt:
    """A choice that was drafted, can be drafted with one of ``kinds``, or cannot because of ``error``.

    Args:
        unstated: whether the description does not state how its joints are commanded.
    """

    choice: ChainChoice
    draft: MachineDraft | None = None
    kinds: tuple[str, ...] = ()
    error: SettingsError | None = None
    unstated: bool = False

    def refusal(self, options: str = "") -> SettingsError:
        """The error of a choice that is not drafted; ``options`` have to be added as well."""
        error = self.error
        assert error is not None
        if self.kinds:
            remedy = f"Add --kind {self.kinds[0]}. Kinds, each of all joints: {_kinds(self.kinds)}."
            return UnknownDriveError(error.where, error.found, error.expected, remedy)
        options = " ".join(filter(None, (options, "--kind servo" if self.unstated else "")))
        if not options or not error.remedy:
            return error
        return SettingsError(error.where, error.found, error.expected, f"{error.remedy} Then add {options}.")


def _attempt(choice: ChainChoice, draft: Callable[[ChainChoice, str | None], MachineDraft], kind: str | None) -> _Attempt:
    """A choice as the user has it; where the description does not state how joints are commanded, with each kind."""
    try:
        return _Attempt(choice, draft(choice, kind))
    except UnknownDriveError as unknown:
        working, reasons = list[str](), list[SettingsError]()
        for each in KINDS:
            try:
                draft(choice, each)
                working.append(each)
            except SettingsError as error:
                reasons.append(error)
        return _Attempt(choice, kinds=tuple(working), error=unknown if working else reasons[0], unstated=True)
    except SettingsError as error:
        return _Attempt(choice, error=error)


def _kinds(names: Iterable[str]) -> str:
    return ", ".join(f"{name} ({KINDS[name]})" for name in names)


def _proposal(attempts: Sequence[_Attempt], where: str) -> SettingsError:
    """The error that proposes the first of several choices, or of one with a held base, that can be drafted."""
    working = [attempt for attempt in attempts if attempt.draft is not None or attempt.kinds]
    if not working:
        answered = [attempt for attempt in attempts if attempt.error is not None and attempt.error.remedy] or attempts
        return answered[0].refusal(answered[0].choice.options())
    first, kind = working[0].choice, next(iter(working[0].kinds), None)
    choices = [attempt.choice for attempt in attempts]
    if len(choices) > 1:
        count = len(first.joints) if len({len(each.joints) for each in choices}) == 1 else "as many"
        found = f"{len(choices)} chains of {count} driven joints, to {listed([each.tip for each in choices], most=8)}"
        found = f"{first.held}, and {found}" if first.held else found
        expected, more = "one machine: a chain of joints", " The other chains are machines of their own, each with its --tip."
    else:
        found, expected, more = first.held, "a base that is fixed to the world", ""
    if first.base is not None:
        more += f" {first.base} is held still then, as on a stand."
    if kind is not None:
        more += f" Kinds: {_kinds(KINDS)}."
    return SettingsError(where, found, expected, f"Add {first.options(kind)}.{more}")


_UNITS = {("velocity", True): "1", ("velocity", False): "1", ("force", True): "N", ("force", False): "N·m"}


def machine_text(draft: MachineDraft, name: str) -> str:
    """``machine.toml``; its URDF is ``<name>.urdf``."""
    lines = [
        f"# Drafted from {comment(draft.source)}. SI units (m, rad, s, N, N·m, kg). Check it before use.",
        "# Fields: docs/guide/mujoco.md",
        _row("schema", "1", "version of this file format"),
        _row("name", toml_value(name), "name of the machine and of its dataset"),
        _row("rate_hz", f"{draft.rate_hz:.1f}", "even time grid of the dataset [Hz], assumed: take that of the fastest log"),
        _row("urdf", toml_value(f"{name}.urdf"), "geometry and masses"),
        _row("tip", toml_value(draft.tip), "URDF link whose origin is the end effector"),
    ]
    lines.append(
        _row("tool", toml_value(draft.tool), "URDF link of a hanging tool")
        if draft.tool is not None
        else '# tool = "…"                     # URDF link of a hanging tool, if it is measured'
    )
    if draft.gravity != GRAVITY:
        lines.append(_row("gravity", f"{draft.gravity:.9g}", "of the model [m/s²]; of the Earth 9.80665"))
    if draft.left_out:
        lines += ["left_out = [                     # what the description contains beyond this file"]
        lines += [*(f"    {toml_value(line)}," for line in draft.left_out), "]"]
    for axis in draft.axes:
        lines += ["", *_axis(axis)]
    lines += [
        "",
        "# [noise]                        # standard deviation of a sensor [SI]; else estimated where the machine rests",
    ]
    lines += [f"# {toml_key(f'{draft.axes[0].name}.joint')} = 1e-4"]
    for effect in (effect for axis in draft.axes for effect in axis.effects):
        lines += ["", *_effect(effect)]
    return "\n".join(lines) + "\n"


def recipe_text(draft: MachineDraft, name: str, prismatic: Sequence[bool]) -> str:
    """``recipe.toml`` for tables whose columns have canonical signal names.

    Args:
        prismatic: whether each axis is.
    """
    example = f"{draft.axes[0].name}.command, {draft.axes[0].name}.joint, …"
    lines = [
        f"# Which column is which signal. As it is: logs/<recording>/*.csv with the columns time, {example}",
        _row("schema", "1", "version of this file format"),
        _row("name", toml_value(name), "name of the dataset"),
        _row("machine", toml_value("machine.toml"), "relative to this file; paths never leave this folder"),
        _row("logs", toml_value("logs"), "each folder in it is one recording; files side by side in it are one together"),
        "",
        "# [recordings.files]             # or, where each file in logs is a recording of its own:",
        '# monday = "monday.csv"          # its name = the file, below logs',
        "",
        "[[streams]]                      # one entry per kind of file",
        _row("files", toml_value("*.csv"), "which files of a recording"),
        _row("time", toml_value("time"), "column of the time stamps"),
        _row(
            "domain", toml_value("machine"), 'the clock of these files; files with another name here are aligned to "machine"'
        ),
        "[streams.signals]                # field: the column; unit: of its values; sign = -1 where it counts the other way",
    ]
    for axis, straight in zip(draft.axes, prismatic, strict=True):
        unit = "m" if straight else "rad"
        for quantity, its in (("command", _UNITS.get((axis.actuation, straight), unit)), ("joint", unit)):
            signal = f"{axis.name}.{quantity}"
            lines.append(f"{toml_key(signal)} = {{ field = {toml_value(signal)}, unit = {toml_value(its)} }}")
    return "\n".join(lines) + "\n"


def _axis(axis: AxisDraft) -> list[str]:
    lines = [
        f"[[axes]]                         # {comment(axis.about)}",
        _row("name", toml_value(axis.name), f"its signals are {axis.name}.command and {axis.name}.joint"),
        _row("joint", toml_value(axis.joint), "URDF joint, whose limits are those of the axis"),
        _row("actuation", toml_value(axis.actuation), "position (response of a servo) | servo | velocity | force"),
        _row("drives", toml_value("joint"), "what the command moves"),
    ]
    if axis.actuation == "velocity":
        lines.append(_row("gain", f"{axis.gain:.6g}", "speed at command 1.0 [rad/s or m/s]"))
    if axis.inertia is not None:
        lines.append(_row("inertia", f"{axis.inertia:.6g}", "of the rotor, beside the masses of the URDF [kg·m² or kg]"))
    if axis.servo is not None:
        lines += [
            "# force = clip(kp·(command − q) − kv·q̇); step, friction: how the simulator makes them",
            f"servo = {_servo(axis.servo)}",
        ]
    if axis.limits is not None:
        lines.append(
            _row("limits", f"[{axis.limits[0]:.6g}, {axis.limits[1]:.6g}]", "end stops; the joint states none: set them")
        )
    return lines


def _servo(law: ServoLaw) -> str:
    """The controller of a servo axis as an inline table."""
    values = [f"kp = {law.kp:.6g}", f"kv = {law.kv:.6g}"]
    if isinstance(law.force_limit, tuple):
        low, high = (max(min(end, LARGEST), -LARGEST) for end in law.force_limit)
        values.append(f"force_limit = [{low:.6g}, {high:.6g}]")
    elif law.force_limit is not None:
        values.append(f"force_limit = {law.force_limit:.6g}")
    if law.step > 0.0:
        values += [f"step = {law.step:.6g}", *([] if law.implicit else ["implicit = false"])]
    if law.friction_give > 0.0:
        values += [f"friction_give = {law.friction_give:.6g}", f"friction_time = {law.friction_time:.6g}"]
    return f"{{ {', '.join(values)} }}"


def _effect(effect: KnownEffect) -> list[str]:
    values = ", ".join(f"{key} = {value:.6g}" for key, value in effect.parameters.items() if isinstance(value, float))
    side = [] if effect.side is None else [f"side = {toml_value(effect.side)}"]
    return [
        "[[effects]]",
        f"name = {toml_value(effect.name)}",
        f"target = {toml_value(effect.target)}",
        *side,
        f"parameters = {{ {values} }}",
    ]


def _row(key: str, value: str, about: str) -> str:
    return f"{f'{key} = {value}':<33}# {about}"
