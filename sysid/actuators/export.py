"""``sysid export actuators/NAME``: the plant of a card for another simulator, with its defaults and the card beside it.

Defaults are the values that simulators have for a joint and its actuator, to be pasted into another model. What they cannot
express (curves and edges of valves, backlash, friction that grows with the load) is listed; the drive model of the export has
it as far as the target can represent it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

from sysid.actuators.card import ActuatorCard
from sysid.effects import effect_named
from sysid.effects.first_order_lag import ABSENT
from sysid.effects.wording import title_of
from sysid.export.drive_data import drive_data, effect_slots
from sysid.export.export import SAMPLES, SEED, Export, export_plant
from sysid.export.target import Target
from sysid.machine.description import Actuation
from sysid.plant import Plant

#: The card, and the defaults for MuJoCo and for Isaac Lab.
CARD, MJCF, ISAACLAB = "card.json", "defaults.xml", "actuators.json"
#: Time step of the model that shows the defaults in use, and the shortest delay that is written [s].
STEP = 2e-3
#: Effects that the values express: those of one size in both directions exactly.
EXPRESSED = ("viscous_friction", "coulomb_friction", "inertia_error", "armature_error", "input_delay", "first_order_lag")


@dataclass(frozen=True)
class JointValues:
    """Values of one joint and its actuator [SI]; None where the recordings show none.

    Args:
        kp, force_limit: of the position loop of a servo.
        delay, lag: of the command [s].
        lacking: what they do not express, in words.
    """

    armature: float | None
    damping: float | None
    frictionloss: float | None
    kp: float | None
    force_limit: float | None
    delay: float | None
    lag: float | None
    lacking: tuple[str, ...]


def joint_values(card: ActuatorCard) -> dict[str, JointValues]:
    """The values of each actuator of a card."""
    plant = card.model
    data = {axis["name"]: axis for axis in drive_data(plant, plant.machine.rate_hz)["axes"]}
    return {name: _values(card, plant, name, data[name].get("mass")) for name in card.axes}


def _values(card: ActuatorCard, plant: Plant, axis: str, mass: float | None) -> JointValues:
    constant = effect_slots(plant, "force_constant_error", axis).get("ratio", 1.0)
    lacking = [
        f"{title_of(effect_named(item.name), axis, plant.machine)} of {axis}"
        for item in plant.effects
        if item.target == axis and item.name not in (*EXPRESSED, "force_constant_error")
    ]
    friction: dict[str, float | None] = {}
    for name in ("viscous_friction", "coulomb_friction"):
        slots = effect_slots(plant, name, axis)
        friction[name] = 0.5 * (slots["positive"] + slots["negative"]) / constant if slots else None
        if slots and slots["positive"] != slots["negative"]:
            title = title_of(effect_named(name), axis, plant.machine)
            lacking.append(f"{title} of {axis} by direction: their mean is written")
    loop = card.loops.get(axis)
    limit = None if loop is None or math.isinf(loop.force_range[1]) else loop.force_range[1]
    delay = effect_slots(plant, "input_delay", axis).get("delay", 0.0)
    lag = effect_slots(plant, "first_order_lag", axis).get("time_constant", 0.0)
    if plant.machine.axis(axis).follows_positions and loop is None:
        lacking.append(f"stiffness of {axis}, which the recordings do not show: give your own kp")
    return JointValues(
        None if card.assumes_inertia(axis) else mass, friction["viscous_friction"], friction["coulomb_friction"],
        None if loop is None else loop.kp, limit, delay if delay >= STEP else None, lag if lag >= ABSENT else None,
        tuple(lacking),
    )  # fmt: skip


def write_mjcf(card: ActuatorCard, folder: Path) -> tuple[str, ...]:
    """Write a ``<default>`` class for each actuator, in a model with a joint of each class, which compiles as it is."""
    machine, values = card.model.machine, joint_values(card)
    root = Element("mujoco", model=card.name)
    for line in (card.title, f"Data: {card.data.source} ({card.data.licence}).", *_remarks(card)):
        root.append(Comment(f" {line.replace('--', '- -')} "))
    SubElement(root, "option", timestep=repr(STEP))
    defaults = SubElement(SubElement(root, "default"), "default", {"class": card.name})
    bodies, actuators = SubElement(root, "worldbody"), SubElement(root, "actuator")
    for number, (axis, found) in enumerate(values.items()):
        kind, joint, drive = _attributes(machine.axis(axis).actuation, found)
        name = f"{card.name}-{axis}"
        own = SubElement(defaults, "default", {"class": name})
        for text in found.lacking:
            own.append(Comment(f" not here: {text} "))
        if joint:
            SubElement(own, "joint", joint)
        SubElement(own, kind, drive)
        about = machine.axis(axis)
        slides = about.drives == "cylinder" or about.joint_type == "prismatic"
        body = SubElement(bodies, "body", name=axis, pos=f"0 {0.5 * number:g} 0")
        places = {"name": axis, "class": name, "type": "slide" if slides else "hinge"}
        SubElement(body, "joint", places | {"axis": "1 0 0" if slides else "0 0 1"})
        SubElement(body, "geom", type="box", size="0.05 0.05 0.05", density="1")
        SubElement(actuators, kind, {"name": axis, "class": name, "joint": axis})
    indent(root)
    (folder / MJCF).write_text(tostring(root, "unicode") + "\n", "utf-8")
    return (MJCF,)


def _attributes(actuation: Actuation, found: JointValues) -> tuple[str, dict[str, str], dict[str, str]]:
    """Name of the actuator's element, and the attributes of joint and actuator."""
    joint = {key: getattr(found, key) for key in ("armature", "damping", "frictionloss")}
    servo = found.kp is not None or actuation in ("position", "servo")
    drive: dict[str, object] = {"kp": found.kp}
    if found.delay is not None:
        drive |= {"delay": found.delay, "nsample": math.ceil(found.delay / STEP) + 2}
    if found.lag is not None:
        drive |= {"timeconst": found.lag} if servo else {"dyntype": "filterexact", "dynprm": found.lag}
    if found.force_limit is not None:
        drive["forcerange"] = f"{-found.force_limit!r} {found.force_limit!r}"
    kind = "position" if servo else "motor" if actuation == "force" and found.lag is None else "general"
    return kind, _texts(joint), _texts(drive)


def _texts(values: Mapping[str, object]) -> dict[str, str]:
    return {key: str(value) for key, value in values.items() if value is not None}


def write_isaaclab(card: ActuatorCard, folder: Path) -> tuple[str, ...]:
    """Write the arguments of an actuator configuration of Isaac Lab 2.3 for each actuator, its delay in seconds beside them.

    ``DelayedPDActuatorCfg(joint_names_expr=[…], **values["cfg"])``; its ``min_delay`` and ``max_delay`` are whole steps of the
    simulation: the ends of ``delay_interval95`` over its time step.
    """
    content = {}
    intervals = {(item.name, item.target): item.interval95 for item in card.values}
    for axis, found in joint_values(card).items():
        cfg = {
            "stiffness": found.kp, "damping": None if found.kp is None else 0.0, "armature": found.armature,
            "friction": found.frictionloss, "dynamic_friction": found.frictionloss, "viscous_friction": found.damping,
            "effort_limit": found.force_limit,
        }  # fmt: skip
        content[axis] = {
            "cfg": {key: value for key, value in cfg.items() if value is not None},
            "delay": found.delay,
            "delay_interval95": intervals.get(("input_delay", axis), {}).get("delay"),
            "lag": found.lag,
            "not_here": list(found.lacking),
        }
    about = {"card": card.name, "title": card.title, "remarks": _remarks(card), "actuators": content}
    (folder / ISAACLAB).write_text(json.dumps(about, indent=1, ensure_ascii=False) + "\n", "utf-8")
    return (ISAACLAB,)


def _remarks(card: ActuatorCard) -> list[str]:
    """Conditions and assumptions of the values."""
    loops = (f"kp and force limit of {axis}: as its logs and data sheet state them, not identified." for axis in card.loops)
    return [*(f"Conditions: {text}." for text in card.data.conditions), *(f"Assumed: {text}." for text in card.assumed), *loops]


#: Target → what writes its defaults.
WRITERS = {"mjcf": write_mjcf, "isaaclab": write_isaaclab}


def export_card(card: ActuatorCard, target: Target, folder: Path, *, samples: int = SAMPLES, seed: int = SEED) -> Export:
    """Write a card for another simulator. It comes without recordings, so that nothing is replayed.

    Args:
        folder: new, empty, or that of an earlier export, which is replaced.
        samples, seed: draws of the parameters.

    Raises:
        SettingsError: the folder contains something else, or the target cannot represent the actuators.
    """

    def beside(half: Path) -> tuple[str, ...]:
        (half / CARD).write_text(json.dumps(card.to_json(), indent=1, ensure_ascii=False) + "\n", "utf-8")
        written = WRITERS[target.name](card, half) if target.name in WRITERS else ()
        return *written, CARD

    ratios = [f"{item.what} {item.ratio:.2f} ({item.signal})" for item in card.replays if item.ratio is not None]
    measured = f" Measured when it was made, error over that of its plant: {', '.join(ratios)}." if ratios else ""
    why = f"Not replayed: a card comes without recordings.{measured}"
    return export_plant(card.model, None, target, folder, samples=samples, seed=seed, beside=beside, unreplayed=why)
