"""Kinds of hidden effects: every effect of the catalogue that a machine of the bench has, and features outside the catalogue.

A kind maps a magnitude to settings of the machine, and has the plausible range, the stage, and the variants and programs that
it needs. Magnitude zero is no effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from agreement.machines import PISTONS
from hidden.machines import COLD_VARIANTS, VARIANTS, Family, Tables, hydraulic_axes
from simulated_bench.recipe import AXES

Stage = Literal["command", "joint", "end_effector", "tool", "force"]
#: (visible tables, magnitude, direction) → changed settings of the hidden machine. ``direction`` is +1 or −1.
Change = Callable[[Tables, float, int], Tables]


@dataclass(frozen=True)
class Kind:
    """One effect at one target of one family, or a feature outside the catalogue; ``label`` is unique.

    Args:
        change: what a magnitude does; ``most``, ``least``: the largest and the smallest plausible one.
        named: what a repaired plant calls it, (effect, target); empty for an unknown one.
        stage, target: where it shows.
        variants: of the family that can have it. excitation: recordings that show it.
        evaluated: whether the bench knows its parameters.
        known: what the owner's machine has otherwise than the variant, so that the effect is what its name says.
    """

    label: str
    family: str
    named: tuple[tuple[str, str], ...]
    stage: Stage
    target: str
    change: Change
    most: float
    variants: tuple[int, ...] = tuple(range(VARIANTS))
    excitation: str = "rich"
    evaluated: bool = True
    least: float = 0.0
    known: Tables = field(default_factory=dict)

    @property
    def key(self) -> str:
        return f"{self.family}:{self.label}"


def _valve(axis: str, **settings: Callable[[Tables, float, int], float]) -> Change:
    """Settings of one valve, each from the visible valve's tables, the magnitude and the direction."""

    def change(tables: Tables, m: float, d: int) -> Tables:
        valve = tables["axes"][axis]["valve"]
        return {"axes": {axis: {"valve": {key: value(valve, m, d) for key, value in settings.items()}}}}

    return change


def _axis(axis: str, **settings: Callable[[float], Any]) -> Change:
    return lambda tables, m, d: {"axes": {axis: {key: value(m) for key, value in settings.items()}}}


def _circuit(axis: str, key: str, value: Callable[[float], float]) -> Change:
    return lambda tables, m, d: {"axes": {axis: {"hydraulics": {key: value(m)}}}}


def _built(**settings: Callable[[float], Any]) -> Change:
    """How the machine was built; the magnitude comes with its sign."""
    return lambda tables, m, d: {"build": {key: value(d * m) for key, value in settings.items()}}


def _sensor(signal: str, **settings: Callable[[float, int], float]) -> Change:
    return lambda tables, m, d: {"sensors": [{"signal": signal, **{key: value(m, d) for key, value in settings.items()}}]}


def _valve_kinds(family: Family) -> list[Kind]:
    """Effects of the command stage that both cranes can have on every axis with a simple valve."""
    found = []
    for axis in AXES:
        variants = tuple(range(VARIANTS))
        if family == "hydraulic_crane":
            variants = tuple(v for v in variants if axis in hydraulic_axes(v))
        changes: list[tuple[str, Change, float]] = [
            ("input_delay", _valve(axis, delay=lambda v, m, d: v["delay"] + m), 0.2),
            (
                "valve_deadband",
                _valve(
                    axis,
                    deadband_positive=lambda v, m, d: v["deadband_positive"] + (m if d > 0 else 0.6 * m),
                    deadband_negative=lambda v, m, d: v["deadband_negative"] + (m if d < 0 else 0.6 * m),
                ),
                0.25,
            ),
            # Short notches are not distinguishable from more overlap.
            ("gain_curve", _valve(axis, taper=lambda v, m, d: d * m), 0.7),
            (
                "flow_saturation",
                _valve(
                    axis,
                    saturation=lambda v, m, d: (1.0 - min(v["deadband_positive"], v["deadband_negative"])) * (1.0 - m),
                ),
                0.6,
            ),
            ("command_rate_limit", _valve(axis, spool_speed=lambda v, m, d: 0.5 / m), 1.0),
        ]
        if family == "valve_crane":
            changes += [
                ("gain_error", _valve(axis, gain=lambda v, m, d: v["gain"] * (1.0 + d * m)), 0.3),
                ("first_order_lag", _valve(axis, time_constant=lambda v, m, d: v["time_constant"] + m), 0.25),
                ("asymmetric_gain", _valve(axis, direction_ratio=lambda v, m, d: 1.0 + d * m), 0.4),
                (
                    "stiction",
                    _valve(axis, silt=lambda v, m, d: min(v["deadband_positive"], v["deadband_negative"]) + m),
                    0.3,
                ),
            ]
        else:
            changes.append(("valve_hysteresis", _circuit(axis, "hysteresis", lambda m: m), 0.2))
        for effect, change, most in changes:
            found.append(Kind(f"{effect}({axis})", family, ((effect, axis),), "command", axis, change, most, variants))
    return found


def _mechanical_kinds() -> list[Kind]:
    """Backlash, sag, geometric errors, sensors and the hanging tool of the valve crane."""

    def kind(effect: str, target: str, stage: Stage, change: Change, most: float, shown: str = "", **more: Any) -> Kind:
        return Kind(f"{effect}({target})", "valve_crane", ((effect, target),), stage, shown or target, change, most, **more)

    found = [
        kind("backlash", "slew", "command", _axis("slew", backlash=lambda m: m), 0.04),
        # The backlash of a cylinder is in metres of its rod on the bench, in radians of the joint in the plant.
        kind("backlash", "boom", "joint", _axis("boom", backlash=lambda m: m), 0.004, evaluated=False),
        kind("backlash", "stick", "joint", _axis("stick", backlash=lambda m: m), 0.004, evaluated=False),
        kind("joint_compliance", "boom", "joint", _axis("boom", stiffness=lambda m: 1.0 / m), 1e-3),
        kind("joint_compliance", "stick", "joint", _axis("stick", stiffness=lambda m: 1.0 / m), 1e-3),
        kind(
            "base_misalignment",
            "base",
            "end_effector",
            lambda t, m, d: {
                "capture": {"shift": [m, -0.7 * m, d * 0.5 * m], "tilt": [d * 0.8 * m, 0.6 * m, -0.5 * m]},
            },
            0.05,
            "ee",
        ),
        kind(
            "gripper_sway",
            "tool",
            "tool",
            lambda t, m, d: {"gripper": {"length": m, "damping_ratio": 0.04}},
            0.3,
            variants=(0, 2, 4),
            least=0.03,  # a hook is longer than a thumb
        ),
    ]
    for axis in ("slew", "boom", "stick"):
        turned = _built(joint_offset=_offset_of(axis))
        found.append(kind("joint_offset", axis, "end_effector", turned, 0.05, "ee"))
    for axis in ("boom", "stick"):
        longer = _built(**{axis: lambda m: m})
        found.append(kind("link_length_error", axis, "end_effector", longer, 0.03, "ee"))
        signal = f"{axis}.cylinder"
        found += [
            kind("sensor_bias", signal, "joint", _sensor(signal, bias=lambda m, d: d * m), 0.01, axis),
            kind("sensor_scale", signal, "joint", _sensor(signal, scale=lambda m, d: 1.0 + d * m), 0.1, axis),
            kind("sensor_quantisation", signal, "command", _sensor(signal, quantum=lambda m, d: m), 0.006, axis),
        ]
    return found


def _slower_back(axis: str) -> Change:
    def change(tables: Tables, m: float, d: int) -> Tables:
        return {"axes": {axis: {"hydraulics": {"retraction": tables["axes"][axis]["valve"]["gain"] * (1.0 + d * m)}}}}

    return change


def _warming(tables: Tables, m: float, d: int) -> Tables:
    return {"oil": {"end": tables["oil"]["start"] + m}}


def _offset_of(axis: str) -> Callable[[float], dict[str, float]]:
    return lambda m: {axis: m}


def _hydraulic_kinds() -> list[Kind]:
    """What only oil does."""
    found = []
    for variant, axis in enumerate(AXES[:3]):
        one = (variant,)

        def kind(effect: str, change: Change, most: float, axis: str = axis, one: tuple[int, ...] = one, **more: Any) -> Kind:
            named = ((effect, axis),)
            return Kind(f"{effect}({axis})", "hydraulic_crane", named, "command", axis, change, most, one, **more)

        if axis != "slew":
            found.append(kind("load_dependent_flow", lambda t, m, d: {"masses": {"balanced": 1.0 - m}}, 1.0))
        if axis == "boom":
            # Leakage needs a load, and that of a boom has one direction; without a load the pressures equalise.
            leaks, loaded = _circuit(axis, "spool_leakage", lambda m: m * 1e-13), {"masses": {"balanced": 0.7}}
            found.append(kind("internal_leakage", leaks, 3.0, excitation="rest", known=loaded))
        found += [
            kind("gain_error", lambda t, m, d: {"supply": {"pressure": 80e5 * (1.0 + d * m)}}, 0.4),
            kind("asymmetric_gain", _slower_back(axis), 0.4),
            kind("oil_compressibility", _circuit(axis, "dead_volume", lambda m: 2e-5 * (1.0 + m)), 200.0),
        ]
        if variant in COLD_VARIANTS:
            # Warm oil changes the two directions of a differential cylinder differently; a cylinder with a rod at either end
            # warms up as the name says.
            even = {"axes": {axis: {"hydraulics": {"area_rod": PISTONS[axis]["area"]}}}}
            found.append(kind("temperature_drift", _warming, 45.0, excitation="long", known=even))
    found.append(
        Kind(
            "pump_flow_limit(machine)",
            "hydraulic_crane",
            (("pump_flow_limit", "machine"),),
            "command",
            "machine",
            lambda t, m, d: {"supply": {"flow_limit": t["supply"]["flow_limit"] / (1.0 + m)}},
            4.0,
            (3, 4, 5),
            "together",
        )
    )
    return found


def _servo_kinds() -> list[Kind]:
    found = []
    for place, axis in enumerate(("shoulder", "elbow")):
        for effect, setting, most in (
            ("input_delay", lambda a, m: {"delay": a["delay"] + m}, 0.15),
            ("first_order_lag", lambda a, m: {"time_constant": a["time_constant"] + m}, 0.2),
            ("command_rate_limit", lambda a, m: {"rate_limit": 0.4 / m}, 1.0),
            ("backlash", lambda a, m: {"backlash": m}, 0.05),
            ("joint_compliance", lambda a, m: {"compliance": m}, 0.01),
        ):

            def change(t: Tables, m: float, d: int, place: int = place, setting: Any = setting) -> Tables:
                return {"axes": {place: setting(t["axes"][place], m)}}

            named = ((effect, axis),)
            found.append(Kind(f"{effect}({axis})", "servo_arm", named, "command", axis, change, most))
    return found


def _slide_kinds() -> list[Kind]:
    def kind(effect: str, change: Change, most: float, variants: Sequence[int] = range(VARIANTS)) -> Kind:
        named = ((effect, "carriage"),)
        return Kind(f"{effect}(carriage)", "slide", named, "force", "carriage", change, most, tuple(variants))

    smooth, rough = (0, 2, 4), (1, 3, 5)
    return [
        kind("coulomb_friction", lambda t, m, d: {"coulomb": m}, 60.0, smooth),
        kind("viscous_friction", lambda t, m, d: {"viscous": t["viscous"] * (1.0 + d * m)}, 0.8),
        # Stribeck friction in addition to known Coulomb friction.
        kind("stribeck_friction", lambda t, m, d: {"static": t["coulomb"] + m}, 30.0, rough),
        kind("inertia_error", lambda t, m, d: {"mass": t["mass"] * (1.0 + d * m)}, 0.5),
        kind("load_bias", lambda t, m, d: {"offset": d * m}, 30.0),
    ]


def _always(value: float) -> Callable[[float], float]:
    return lambda m: value


def _unknown_kinds() -> list[Kind]:
    def drive(axis: str, label: str, most: float, **settings: Callable[[float], float]) -> Kind:
        change = _axis(axis, irregular=lambda m: {key: value(m) for key, value in settings.items()})
        return Kind(f"{label}({axis})", "valve_crane", (), "command", axis, change, most)

    found = []
    for axis, pitch in (("slew", 0.9), ("boom", 0.03), ("stick", 0.04), ("telescope", 0.07)):
        found += [
            drive(axis, "uneven", 0.4, uneven=lambda m: m, pitch=_always(pitch)),
            drive(axis, "ripple", 0.6, ripple=lambda m: m, ripple_frequency=lambda m: 0.7),
            drive(axis, "slip", 0.6, slip=lambda m: m, slip_above=lambda m: 0.45),
            drive(axis, "fade", 0.6, fade=lambda m: m, fade_time=lambda m: 4.0),
        ]
    for place, axis in enumerate(("shoulder", "elbow")):

        def wobble(t: Tables, m: float, d: int, place: int = place) -> Tables:
            return {"axes": {place: {"eccentricity": m, "teeth": 9.0}}}

        found.append(Kind(f"eccentricity({axis})", "servo_arm", (), "command", axis, wobble, 0.03))
    found.append(Kind("cogging(carriage)", "slide", (), "force", "carriage", lambda t, m, d: {"cogging": m}, 40.0))
    return found


#: Kinds with a name in the catalogue, and without.
KNOWN: tuple[Kind, ...] = (
    *_valve_kinds("valve_crane"),
    *_mechanical_kinds(),
    *_valve_kinds("hydraulic_crane"),
    *_hydraulic_kinds(),
    *_servo_kinds(),
    *_slide_kinds(),
)
UNKNOWN: tuple[Kind, ...] = tuple(_unknown_kinds())
BY_KEY = {kind.key: kind for kind in (*KNOWN, *UNKNOWN)}
