"""The machines as MJCF, MuJoCo's model files; every feature is an element or attribute of MuJoCo's own.

| feature | element |
| --- | --- |
| dead time | ``actuator/…/delay`` with ``nsample`` |
| lag of a speed servo | inertia of the rotor (``armature``) over the servo's ``kd`` |
| lag of a servo that holds its place | ``kv`` over ``kp``; of the arm's servo ``timeconst`` (an exact filter) |
| saturation, sides of different speed | ``ctrlrange`` of one or two actuators |
| rate limit | ``slewmax`` of the ``dcmotor`` controller |
| dry friction | ``frictionloss``, or ``lugre`` of a passive ``dcmotor`` |
| play, springs in a drive | a rotor of its own, tied to the joint by a tendon with ``range`` or ``stiffness`` |
| uneven gear | ``equality/joint`` with a polynomial |
| cogging | ``cogging`` of a passive ``dcmotor`` |
| soft wall | spring of a tendon that begins at a length (``springlength``) |
| hanging tool | ball joint with damping |
"""

from __future__ import annotations

import math
from xml.etree import ElementTree as Xml
from xml.etree.ElementTree import Element

from hidden.foreign.machines import CRANE_AXES, Tables

#: Of the crane: inertia of a rotor behind its gear [kg·m² or kg]; a servo that holds its place settles this fast [s].
ROTOR, SETTLING = 60.0, 1e-3
#: Inertia in front of a drive that has a spring in it [kg·m²].
RINGING_LINK = 6.0
#: Masses of the crane's bodies [kg]: light beside the rotors, so that a lag hardly depends on the pose; the tool is a
#: plumb that no drive feels.
MASSES = {"slew": 1.0, "boom": 0.4, "stick": 0.2, "telescope": 0.1, "tool": 2e-5}
#: Of the servo arm: stiffness of a servo [N·m/rad], and inertia behind the gear [kg·m²].
STIFF, GEARED = 2e4, 0.5
#: Inertia of a link of the arm for which a spring before it is half critically damped [kg·m²].
ARM_LINK = 0.05
#: Contacts and limits of friction are stiff, so that a machine that stands does not creep.
HARD = {"solreffriction": "0.004 1", "solimpfriction": "0.99 0.99 0.001"}
#: Damping of bristles over their stiffness [s].
BRISTLE = 1e-3
#: Bodies that only carry a joint.
NEXT_TO_NOTHING = {"pos": "0 0 0", "mass": "0.001", "diaginertia": "1e-6 1e-6 1e-6"}
#: A winding of a passive motor has to have a resistance, though nothing is driven through it.
PASSIVE = {"input": "none", "resistance": "1", "motorconst": "0 0"}


def mjcf(tables: Tables) -> str:
    """The model file of a machine."""
    model = Xml.Element("mujoco", model=tables["family"])
    add(model, "compiler", angle="radian", autolimits="true")
    add(model, "option", timestep=text(tables["step"]), integrator="implicitfast", gravity="0 0 -9.81")
    parts = {name: Xml.Element(name) for name in ("worldbody", "tendon", "equality", "actuator")}
    {"mujoco_crane": _crane, "mujoco_arm": _arm, "mujoco_slide": _slide}[tables["family"]](tables, parts)
    model.extend(part for part in parts.values() if len(part))
    Xml.indent(model)
    return Xml.tostring(model, encoding="unicode")


def add(parent: Element, tag: str, **attributes: str) -> Element:
    """A new child element."""
    return Xml.SubElement(parent, tag, attributes)


def text(*values: float) -> str:
    return " ".join(f"{value:.12g}" for value in values)


# ---- Crane --------------------------------------------------------------------------------------------------------------


def _crane(tables: Tables, parts: dict[str, Element]) -> None:
    build, links = tables["build"], tables["links"]
    # Pose of the base: translation, then rotation vector.
    angle = math.hypot(*build["rotation"])
    turned = [value / angle for value in build["rotation"]] if angle else [1.0, 0.0, 0.0]
    parent = add(parts["worldbody"], "body", name="base", pos=text(*build["translation"]), axisangle=text(*turned, angle))
    longer = build["longer"]
    places = {
        "slew": (0.0, 0.0, 0.0),
        "boom": (0.0, 0.0, links["height"]),
        "stick": (links["boom"] + longer.get("boom", 0.0), 0.0, 0.0),
        "telescope": (links["stick"] + longer.get("stick", 0.0), 0.0, 0.0),
    }
    for name in CRANE_AXES:
        parent = _crane_axis(tables, name, places[name], parent, parts)
    add(parent, "site", name="ee")
    tool = tables["tool"]
    carried = tables["gravity_carried"] and tool["length"] == 0.0
    hanging = add(parent, "body", name="tool", gravcomp=text(float(carried)))
    mass = MASSES["tool"]
    if tool["length"] > 0.0:
        natural = math.sqrt(9.81 / tool["length"])
        damping = 2.0 * tool["damping_ratio"] * mass * tool["length"] ** 2 * natural
        add(hanging, "joint", name="hook", type="ball", damping=text(damping))
    add(hanging, "inertial", pos=text(0.0, 0.0, -tool["length"]), mass=text(mass), diaginertia="1e-11 1e-11 1e-11")
    add(hanging, "site", name="tool", pos=text(0.0, 0.0, -tool["length"]))


def _crane_axis(tables: Tables, name: str, place: tuple[float, ...], parent: Element, parts: dict[str, Element]) -> Element:
    """One link behind its drive; returns the body that carries the next one."""
    axis, carried = tables["axes"][name], tables["gravity_carried"]
    about = {"slew": (0.0, 0.0, 1.0), "telescope": (1.0, 0.0, 0.0)}.get(name, (0.0, -1.0, 0.0))
    turn = tables["build"]["turn"].get(name, 0.0)
    weight = text(1.0 if carried or name == "slew" else 0.0)
    body = add(parent, "body", name=name, pos=text(*place), axisangle=text(*about, turn), gravcomp=weight)
    kind = "slide" if name == "telescope" else "hinge"
    behind = "play" in axis or "spring" in axis or "uneven" in axis
    low, high = axis["limits"]
    shared = {"type": kind, "axis": text(*about)}
    servo = ROTOR / axis["lag"]
    friction = axis["friction"] * servo * axis["gain"]
    joint = add(body, "joint", name=name, range=text(low, high), frictionloss=text(friction), **shared, **HARD)
    if behind:
        rotor = add(parent, "body", name=f"{name}_rotor", pos=text(*place), gravcomp="1")
        ahead = RINGING_LINK if "spring" in axis else 0.0
        add(rotor, "joint", name=f"{name}_rotor", armature=text(ROTOR - ahead), **shared)
        add(rotor, "inertial", **NEXT_TO_NOTHING)
        joint.set("armature", text(ahead))
        _tie(name, axis, parts)
    else:
        joint.set("armature", text(ROTOR))
    if "wall" in axis:
        _spring_wall(name, axis["wall"], servo, parts)
    length = {"boom": tables["links"]["boom"], "stick": tables["links"]["stick"]}.get(name, 0.2)
    if "compliance" in axis:
        # Behind the sensor: the measured joint turns, the structure gives way.
        add(body, "inertial", **NEXT_TO_NOTHING)
        body = add(body, "body", name=f"{name}_structure", gravcomp=weight)
        stiff = 1.0 / axis["compliance"]
        give = {"stiffness": text(stiff), "damping": text(0.02 * stiff)}
        add(body, "joint", name=f"{name}_structure", **give, **shared)
    centre = text(0.0, 0.0, 0.1) if name == "slew" else text(-0.5 * length if name == "telescope" else 0.5 * length, 0.0, 0.0)
    thin = text(*(MASSES[name] * length**2 / 12.0 for _ in range(3)))
    add(body, "inertial", pos=centre, mass=text(MASSES[name]), diaginertia=thin)
    _crane_drive(name, f"{name}_rotor" if behind else name, axis, tables["step"], parts["actuator"])
    return body


def _tie(name: str, axis: Tables, parts: dict[str, Element]) -> None:
    """Connection of the joint with its rotor: backlash, a spring, or an uneven gear."""
    if "uneven" in axis:
        slope, bend = axis["uneven"]
        add(
            parts["equality"], "joint", joint1=name, joint2=f"{name}_rotor", polycoef=text(0.0, 1.0, slope, bend, 0.0),
            solref="0.004 1", solimp="0.999 0.999 0.001",
        )  # fmt: skip
        return
    tendon = add(parts["tendon"], "fixed", name=name)
    if "play" in axis:
        tendon.set("range", text(-0.5 * axis["play"], 0.5 * axis["play"]))
        tendon.set("solreflimit", "0.004 1")
        tendon.set("solimplimit", "0.99 0.999 0.0001")
    elif "compliance" in axis:
        tendon.set("stiffness", text(1.0 / axis["compliance"]))
        tendon.set("damping", text(math.sqrt(ARM_LINK / axis["compliance"])))
        tendon.set("springlength", "0")
    else:
        stiffness = spring_stiffness(axis)
        tendon.set("stiffness", text(stiffness))
        tendon.set("damping", text(2.0 * axis["spring"][1] * math.sqrt(stiffness * RINGING_LINK)))
        tendon.set("springlength", "0")
    for joint, sign in ((f"{name}_rotor", 1.0), (name, -1.0)):
        add(tendon, "joint", joint=joint, coef=text(sign))


def spring_stiffness(axis: Tables) -> float:
    """Of a drive that rings at ``spring[0]`` Hz with what is in front of it [N·m/rad]."""
    return float(RINGING_LINK * (2.0 * math.pi * axis["spring"][0]) ** 2)


def _spring_wall(name: str, wall: Tables, scale: float, parts: dict[str, Element]) -> None:
    """An elastic stop inside the range: a tendon of one joint whose spring begins at a length."""
    tendon = add(parts["tendon"], "fixed", name=f"{name}_wall", springlength=text(-100.0, wall["at"]))
    tendon.set("stiffness", text(wall["stiffness"] * scale))
    add(tendon, "joint", joint=name, coef="1")


def _crane_drive(name: str, joint: str, axis: Tables, step: float, actuators: Element) -> None:
    """Commands are speeds [rad/s or m/s]; two actuators where the sides differ, the first has the feedback."""
    shared = {"joint": joint, **_delayed(axis["delay"], step)}
    most = axis.get("saturation", 10.0) * axis["gain"]
    sides = [(-most, most, 1.0)]
    if "ratio" in axis:
        sides = [(0.0, most, 1.0), (-most, 0.0, axis["ratio"])]
    for k, (low, high, factor) in enumerate(sides):
        limits = {"name": f"{name}_{k}", "ctrlrange": text(low, high)}
        if axis["servo"] == "place":
            damping = ROTOR / SETTLING
            stiff = damping / axis["lag"]
            held = {"biasprm": text(0.0, -stiff, -damping) if k == 0 else "0 0 0", "gainprm": text(factor * stiff, 0.0, 0.0)}
            add(actuators, "general", dyntype="integrator", biastype="affine", **held, **limits, **shared)
            continue
        servo = ROTOR / axis["lag"]
        if "slew_rate" in axis:
            controller = text(0.0, 0.0, servo, axis["slew_rate"] * axis["gain"], 0.0, 0.0)
            motor = {"input": "vel", "resistance": "1", "motorconst": "1 1", "controller": controller}
            add(actuators, "dcmotor", **motor, **limits, **shared)
            continue
        pushed = axis.get("push", 0.0) * servo * axis["gain"]
        back = text(pushed, 0.0, -servo) if k == 0 else "0 0 0"
        add(actuators, "general", biastype="affine", biasprm=back, gainprm=text(factor * servo, 0.0, 0.0), **limits, **shared)
    _passive(name, joint, axis, actuators, ROTOR / axis["lag"] * axis["gain"])


def _passive(name: str, joint: str, axis: Tables, actuators: Element, scale: float) -> None:
    """What a motor does without a current: cogging, bristles that bend before they slide. Forces in units of ``scale``."""
    if "cogging" in axis:
        size, poles = axis["cogging"]
        add(actuators, "dcmotor", name=f"{name}_cogging", joint=joint, cogging=text(size * scale, poles, 0.0), **PASSIVE)
    if "lugre" in axis:
        stiffness, sliding, static, speed = axis["lugre"]
        lugre = text(stiffness * scale, BRISTLE * stiffness * scale, sliding * scale, static * scale, speed)
        add(actuators, "dcmotor", name=f"{name}_lugre", joint=joint, lugre=lugre, **PASSIVE)


def _delayed(delay: float, step: float) -> dict[str, str]:
    """Attributes of a dead time; the history holds a sample a step.

    It is read half a step from its stamps: at them, rounding decides which sample is taken, a step sooner or later.
    """
    return {"delay": text(delay - 0.5 * step), "nsample": str(round(delay / step) + 2)} if delay > 0.0 else {}


# ---- Servo arm ----------------------------------------------------------------------------------------------------------


def _arm(tables: Tables, parts: dict[str, Element]) -> None:
    parent, at = parts["worldbody"], 0.0
    weight = text(1.0 - tables["gravity"])
    for name, axis in tables["axes"].items():
        body = add(parent, "body", name=name, pos=text(at, 0.0, 0.0), gravcomp=weight)
        shared = {"type": "hinge", "axis": "0 -1 0"}
        behind = "play" in axis or "uneven" in axis or "compliance" in axis
        joint = add(body, "joint", name=name, range=text(*axis["limits"]), **shared, **HARD)
        if behind:
            rotor = add(parent, "body", name=f"{name}_rotor", pos=text(at, 0.0, 0.0), gravcomp="1")
            add(rotor, "joint", name=f"{name}_rotor", armature=text(GEARED), **shared)
            add(rotor, "inertial", **NEXT_TO_NOTHING)
            _tie(name, axis, parts)
            joint.set("frictionloss", text(axis.get("friction", 0.0)))
        else:
            joint.set("armature", text(GEARED))
        moment = axis["mass"] * axis["length"] ** 2 / 12.0
        add(
            body, "inertial", pos=text(0.5 * axis["length"], 0.0, 0.0), mass=text(axis["mass"]),
            diaginertia=text(moment, moment, moment),
        )  # fmt: skip
        _arm_drive(name, f"{name}_rotor" if behind else name, axis, tables, parts["actuator"])
        parent, at = body, axis["length"]


def _arm_drive(name: str, joint: str, axis: Tables, tables: Tables, actuators: Element) -> None:
    step = tables["step"]
    shared = {"name": f"{name}_0", "joint": joint, **_delayed(axis["delay"], step)}
    stiff = STIFF
    if tables["motor"] == "dcmotor":
        controller = text(stiff, 0.0, axis["lag"] * stiff, axis.get("slew_rate", 0.0), 0.0, 0.0)
        driven = {"input": "pos", "resistance": "1", "motorconst": "1 1", "controller": controller}
        add(actuators, "dcmotor", **driven, **shared)
    else:
        # Two lags: the filter of the setpoint, and the servo's own.
        own = 0.3 * axis["lag"]
        add(actuators, "position", kp=text(stiff), kv=text(own * stiff), timeconst=text(axis["lag"] - own), **shared)
    _passive(name, joint, axis, actuators, 1.0)


# ---- Slide --------------------------------------------------------------------------------------------------------------


def _slide(tables: Tables, parts: dict[str, Element]) -> None:
    body = add(parts["worldbody"], "body", name="carriage", gravcomp="1")
    spring = {"stiffness": text(tables["spring"])} if "spring" in tables else {}
    add(
        body, "joint", name="carriage", type="slide", axis="1 0 0", range=text(*tables["limits"]),
        damping=text(tables["viscous"]), frictionloss=text(tables["coulomb"]), **spring, **HARD,
    )  # fmt: skip
    add(body, "inertial", pos="0 0 0", mass=text(tables["inertia"]), diaginertia="1 1 1")
    if "wall" in tables:
        _spring_wall("carriage", tables["wall"], 1.0, parts)
    add(
        parts["actuator"], "general", name="carriage_0", joint="carriage", biastype="affine", gainprm="1 0 0",
        biasprm=text(-tables["load"], 0.0, 0.0),
    )  # fmt: skip
    _passive("carriage", "carriage", tables, parts["actuator"], 1.0)
