"""Kinds of hidden effects in the foreign simulators, with their names in the catalogue, and features without a name.

Magnitude zero is no effect. The simulator's equation is hidden, not the plant's: a dead-band is dry friction here, an
oscillation a spring in the drive, backlash a rotor that is tied loosely.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hidden.foreign.machines import ARM_AXES, CONTROLLED, CRANE_AXES, LOADED, VARIANTS, Family, Tables
from hidden.kinds import Change, Kind, Stage

#: Variants of the crane whose drives of boom, stick and telescope are speed servos, and those with dry friction that is known.
SPEED, ROUGH, SMOOTH = (0, 2), (2, 3), (0, 1)
EVERY = tuple(range(VARIANTS))
#: Damping ratio of a spring in a drive, and period of the stiffest one [s].
RINGING, STIFFEST = 0.06, 0.02
#: Compliance of the stiffest spring that a step of the simulator can follow [rad/(N·m)].
STIFF_SPRING = 1e-4
#: Deflection at which stiff bristles slide [m].
BRISTLES = 2e-5
#: Friction that holds a link inside its backlash [N·m].
HELD = 2.0


def _axis(axis: str, **settings: Callable[[Tables, float, int], Any]) -> Change:
    """Settings of one axis, each from the known axis' table, the magnitude and the direction."""

    def change(tables: Tables, m: float, d: int) -> Tables:
        known = tables["axes"][axis]
        return {"axes": {axis: {key: value(known, m, d) for key, value in settings.items()}}}

    return change


def _machine(**settings: Callable[[Tables, float, int], Any]) -> Change:
    return lambda tables, m, d: {key: value(tables, m, d) for key, value in settings.items()}


def _sensor(signal: str, **settings: Callable[[float, int], float]) -> Change:
    return lambda tables, m, d: {"sensors": {signal: {key: value(m, d) for key, value in settings.items()}}}


def _built(part: str, axis: str) -> Change:
    return lambda tables, m, d: {"build": {part: {axis: d * m}}}


def _misplaced(tables: Tables, m: float, d: int) -> Tables:
    translation, rotation = [m, -0.7 * m, d * 0.5 * m], [d * 0.8 * m, 0.6 * m, -0.5 * m]
    return {"build": {"translation": translation, "rotation": rotation}}


def _bristles(tables: Tables, m: float, d: int) -> Tables:
    """The friction that is known, from bristles that bend by the magnitude before they slide."""
    force = tables["coulomb"]
    return {"lugre": (force / m, force, force, 0.01), "coulomb": 0.0}


def _speed_kinds(axis: str) -> list[tuple[str, Change, float, tuple[int, ...]]]:
    """Of a crane's axis whose drive is a speed servo: name, change, largest magnitude, variants."""
    speed = EVERY if axis == "slew" else SPEED
    rough = tuple(v for v in speed if v in ROUGH)
    found: list[tuple[str, Change, float, tuple[int, ...]]] = [
        ("command_rate_limit", _axis(axis, slew_rate=lambda a, m, d: 0.5 / m), 1.0, tuple(v for v in speed if v not in rough)),
        ("valve_deadband", _axis(axis, friction=lambda a, m, d: a["friction"] + m), 0.2, speed),
        ("internal_leakage", _axis(axis, push=lambda a, m, d: d * m), 0.05, tuple(v for v in speed if v not in rough)),
        ("backlash", _axis(axis, play=lambda a, m, d: m), 0.02 if axis == "telescope" else 0.04, rough),
    ]
    return found


def _crane_kinds() -> list[Kind]:
    def kind(effect: str, target: str, stage: Stage, change: Change, most: float, shown: str = "", **more: Any) -> Kind:
        return Kind(f"{effect}({target})", "mujoco_crane", ((effect, target),), stage, shown or target, change, most, **more)

    found = []
    for axis in CRANE_AXES:
        anywhere: list[tuple[str, Change, float, tuple[int, ...]]] = [
            ("input_delay", _axis(axis, delay=lambda a, m, d: round(a["delay"] + m, 3)), 0.2, EVERY),
            (
                "first_order_lag",
                _axis(axis, lag=lambda a, m, d: a["lag"] + m),
                0.25,
                EVERY if axis == "slew" else (*LOADED, 0),
            ),
            ("gain_error", _axis(axis, gain=lambda a, m, d: a["gain"] * (1.0 + d * m)), 0.3, EVERY),
            ("asymmetric_gain", _axis(axis, ratio=lambda a, m, d: 1.0 + d * m), 0.4, EVERY),
            ("flow_saturation", _axis(axis, saturation=lambda a, m, d: 1.0 - m), 0.6, EVERY),
        ]
        for effect, change, most, variants in [*anywhere, *_speed_kinds(axis)]:
            found.append(kind(effect, axis, "command", change, most, variants=variants))
        stepped = _sensor(f"{axis}.joint", quantum=lambda m, d: m)
        found.append(kind("sensor_quantisation", f"{axis}.joint", "command", stepped, 0.02, axis, variants=EVERY))
    ringing = _axis("slew", spring=lambda a, m, d: (1.0 / (STIFFEST + m), RINGING))
    found += [
        kind("oil_compressibility", "slew", "command", ringing, 0.6, variants=SMOOTH),
        kind("sensor_scale", "telescope.joint", "command", _sensor("telescope.joint", scale=lambda m, d: 1.0 + d * m), 0.1,
             "telescope", variants=EVERY),
        kind("base_misalignment", "base", "end_effector", _misplaced, 0.05, "ee", variants=EVERY),
        kind("gripper_sway", "tool", "tool", lambda t, m, d: {"tool": {"length": m, "damping_ratio": 0.05}}, 0.3, least=0.03,
             variants=SPEED),
    ]  # fmt: skip
    for axis in ("slew", "boom", "stick"):
        found.append(kind("joint_offset", axis, "end_effector", _built("turn", axis), 0.05, "ee", variants=EVERY))
    for axis in ("boom", "stick"):
        found.append(kind("link_length_error", axis, "end_effector", _built("longer", axis), 0.03, "ee", variants=EVERY))
        gives = _axis(axis, compliance=lambda a, m, d: m)
        found.append(kind("joint_compliance", axis, "end_effector", gives, 0.02, "ee", variants=LOADED))
    return found


def _arm_kinds(family: Family) -> list[Kind]:
    found = []
    for axis in ARM_AXES:
        signal = f"{axis}.joint"
        kinds: list[tuple[str, str, Change, float, Tables]] = [
            ("first_order_lag", axis, _axis(axis, lag=lambda a, m, d: a["lag"] + m), 0.2, {}),
            ("command_rate_limit", axis, _axis(axis, slew_rate=lambda a, m, d: 0.4 / m), 1.0, {}),
            ("sensor_bias", signal, _sensor(signal, bias=lambda m, d: d * m), 0.05, {}),
            ("sensor_scale", signal, _sensor(signal, scale=lambda m, d: 1.0 + d * m), 0.1, {}),
            ("sensor_quantisation", signal, _sensor(signal, quantum=lambda m, d: m), 0.02, {}),
        ]
        if family == "mujoco_arm":
            held = {"axes": {axis: {"friction": HELD}}}
            kinds += [
                ("input_delay", axis, _axis(axis, delay=lambda a, m, d: round(a["delay"] + m, 3)), 0.15, {}),
                ("backlash", axis, _axis(axis, play=lambda a, m, d: m), 0.05, held),
                ("joint_compliance", axis, _axis(axis, compliance=lambda a, m, d: m), 0.02, {"gravity": 1.0}),
            ]
        for effect, target, change, most, known in kinds:
            limited = effect == "command_rate_limit" and family == "mujoco_arm"
            more: dict[str, Any] = {"variants": CONTROLLED if limited else EVERY, "known": known}
            if effect == "joint_compliance":
                more["least"] = STIFF_SPRING
            found.append(Kind(f"{effect}({target})", family, ((effect, target),), "command", axis, change, most, **more))
    return found


def _pushed_kinds(family: Family, axis: str) -> list[Kind]:
    """Magnitudes of forces in N or N·m."""
    size = 60.0 if family == "mujoco_slide" else 3.0

    def kind(effect: str, change: Change, most: float, variants: tuple[int, ...] = EVERY) -> Kind:
        return Kind(f"{effect}({axis})", family, ((effect, axis),), "force", axis, change, most, variants=variants)

    found = [
        kind("coulomb_friction", _machine(coulomb=lambda t, m, d: t["coulomb"] + m), size),
        kind("viscous_friction", _machine(viscous=lambda t, m, d: t["viscous"] * (1.0 + d * m)), 0.8),
        kind(
            "inertia_error",
            _machine(inertia=lambda t, m, d: t["inertia"] * (1.0 + d * m), tuned=lambda t, m, d: t["inertia"]),
            0.5,
        ),
        kind("load_bias", _machine(load=lambda t, m, d: d * m), 0.5 * size),
    ]
    if family == "mujoco_slide":
        # Stribeck friction in addition to known Coulomb friction.
        dip = _machine(lugre=lambda t, m, d: (m / BRISTLES, 0.02 * m, m, 0.01))
        found.append(kind("stribeck_friction", dip, 0.5 * size, (1, 3)))
    return found


def _wall(at: float) -> Callable[[Tables, float, int], Tables]:
    """A wall that begins at this share of the range; the magnitude is its stiffness, with a servo that over the servo's."""

    def wall(about: Tables, m: float, d: int) -> Tables:
        low, high = about["limits"]
        return {"at": low + at * (high - low), "stiffness": m}

    return wall


def _unknown_kinds() -> list[Kind]:
    def kind(
        family: Family,
        axis: str,
        label: str,
        change: Change,
        most: float,
        variants: tuple[int, ...] = EVERY,
        least: float = 0.0,
    ) -> Kind:
        stage: Stage = "force" if axis in ("carriage", "lever") else "command"
        return Kind(f"{label}({axis})", family, (), stage, axis, change, most, variants=variants, least=least)

    found = []
    for axis in ("slew", "boom", "stick"):
        speed = EVERY if axis == "slew" else SPEED
        smooth = tuple(v for v in speed if v not in ROUGH)
        found += [
            kind("mujoco_crane", axis, "uneven gear", _axis(axis, uneven=lambda a, m, d: (d * m, -m)), 0.2, smooth),
            kind("mujoco_crane", axis, "cogging", _axis(axis, cogging=lambda a, m, d: (m, 12.0)), 0.6, smooth),
            kind("mujoco_crane", axis, "soft wall", _axis(axis, wall=_wall(0.55)), 0.05, speed),
        ]
    for axis in ARM_AXES:
        found += [
            kind("mujoco_arm", axis, "uneven gear", _axis(axis, uneven=lambda a, m, d: (d * m, -m)), 0.1),
            kind("bullet_arm", axis, "weak motor", _axis(axis, strength=lambda a, m, d: 1.0 / m), 20.0),
        ]
    found += [
        kind("mujoco_slide", "carriage", "cogging", _machine(cogging=lambda t, m, d: (m, 209.0)), 40.0),
        kind("mujoco_slide", "carriage", "spring", _machine(spring=lambda t, m, d: m), 500.0),
        kind("mujoco_slide", "carriage", "soft wall", _machine(wall=_wall(0.6)), 2000.0),
        kind("mujoco_slide", "carriage", "bristles", _bristles, 0.02, (1, 3), BRISTLES),
        kind("bullet_lever", "lever", "soft wall", _machine(wall=_wall(0.6)), 2000.0),
        kind("bullet_lever", "lever", "unbalance", _machine(unbalance=lambda t, m, d: m), 4.0),
    ]  # fmt: skip
    return found


#: Everything that has a name, and what has none.
KNOWN: tuple[Kind, ...] = (
    *_crane_kinds(),
    *_arm_kinds("mujoco_arm"),
    *_arm_kinds("bullet_arm"),
    *_pushed_kinds("mujoco_slide", "carriage"),
    *_pushed_kinds("bullet_lever", "lever"),
)
UNKNOWN: tuple[Kind, ...] = tuple(_unknown_kinds())
BY_KEY = {kind.key: kind for kind in (*KNOWN, *UNKNOWN)}
