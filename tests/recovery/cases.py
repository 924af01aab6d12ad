"""Every effect at every kind of place it can have, with parameters a machine might have."""

from __future__ import annotations

from plant_data import CAPTURE, loaded_arm, nominal, slide

from sysid.machine import KnownEffect
from sysid.plant import Plant

#: What the simulation knows beforehand: a lag and a dead time on each axis, since no real axis is without.
KNOWN = (
    KnownEffect("first_order_lag", "slew", {"time_constant": 0.05}),
    KnownEffect("first_order_lag", "boom", {"time_constant": 0.05}),
    KnownEffect("first_order_lag", "wrist", {"time_constant": 0.06}),
    KnownEffect("input_delay", "slew", {"delay": 0.03}),
    KnownEffect("input_delay", "boom", {"delay": 0.03}),
)


#: Friction of the slide that the simulation knows. A film of oil shows while something viscous lets it creep; a force constant
#: differs from an inertia by the friction beside it.
FRICTION = {
    "stribeck_friction": (KnownEffect("viscous_friction", "slide", {"coefficient": 400.0}),),
    "force_constant_error": (
        KnownEffect("coulomb_friction", "slide", {"force": 18.0}),
        KnownEffect("viscous_friction", "slide", {"coefficient": 35.0}),
    ),
}
#: Effects of the weight: their machine has masses.
WEIGHED = ("load_dependent_flow", "joint_compliance")


def base(effect: KnownEffect) -> Plant:
    """The simulation that lacks ``effect``. The boom's joint and the tool are seen by motion capture."""
    if effect.target == "slide":
        return nominal(*FRICTION.get(effect.name, ()), machine=slide())
    known = (item for item in KNOWN if item.name != effect.name or item.target != effect.target)
    return nominal(*known, machine=loaded_arm() if effect.name in WEIGHED else None, streams=CAPTURE)


CASES: tuple[KnownEffect, ...] = (
    KnownEffect("input_delay", "slew", {"delay": 0.083}),
    KnownEffect("input_delay", "wrist", {"delay": 0.06}),
    KnownEffect("valve_hysteresis", "boom", {"width": 0.06}),
    KnownEffect("valve_deadband", "boom", {"positive": 0.11, "negative": 0.08}),
    KnownEffect("valve_deadband", "slew", {"positive": 0.05, "negative": 0.12}),
    KnownEffect("gain_curve", "boom", {"exponent": 1.5}),
    KnownEffect("flow_saturation", "slew", {"limit": 0.6}),
    KnownEffect("command_rate_limit", "boom", {"rate": 2.0}),
    KnownEffect("command_rate_limit", "wrist", {"rate": 1.2}),
    KnownEffect("first_order_lag", "boom", {"time_constant": 0.12}),
    KnownEffect("first_order_lag", "wrist", {"time_constant": 0.09}),
    KnownEffect("second_order_lag", "wrist", {"time_constant": 0.08, "damping_ratio": 0.5}),
    KnownEffect("gain_error", "slew", {"ratio": 0.86}),
    KnownEffect("asymmetric_gain", "boom", {"ratio": 1.3}),
    KnownEffect("internal_leakage", "boom", {"rate": 2e-4}),
    KnownEffect("stiction", "boom", {"breakaway": 0.2, "release": 0.1}),
    KnownEffect("stiction", "boom", {"spool_breakaway": 0.2, "spool_release": 0.02}),
    KnownEffect("temperature_drift", "slew", {"fraction": 0.2, "time_constant": 8.0}),
    KnownEffect("load_dependent_flow", "boom", {"coefficient": 0.004}),
    KnownEffect("oil_compressibility", "boom", {"frequency": 5.0, "damping_ratio": 0.1}),
    KnownEffect("oil_compressibility", "slew", {"frequency": 7.0, "damping_ratio": 0.15}),
    KnownEffect("pump_flow_limit", "machine", {"limit": 0.7}),
    KnownEffect("backlash", "slew", {"width": 0.012}, "drive"),
    KnownEffect("backlash", "boom", {"width": 0.01}, "drive"),
    KnownEffect("backlash", "slew", {"width": 0.015}, "structure"),
    KnownEffect("backlash", "wrist", {"width": 0.02}, "drive"),
    KnownEffect("joint_compliance", "boom", {"compliance": 5e-4}, "drive"),
    KnownEffect("joint_compliance", "boom", {"compliance": 5e-4}, "structure"),
    KnownEffect("joint_compliance", "wrist", {"compliance": 2e-3}, "drive"),
    KnownEffect("joint_compliance", "wrist", {"compliance": 2e-3}, "structure"),
    KnownEffect("joint_offset", "boom", {"offset": 0.01}),
    KnownEffect("link_length_error", "boom", {"error": -0.008}),
    KnownEffect("base_misalignment", "base", {"translation": [0.012, -0.02, 0.008], "rotation": [0.015, -0.01, 0.0]}),
    KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}),
    KnownEffect("coulomb_friction", "slide", {"force": 18.0}),
    KnownEffect("coulomb_friction", "slide", {"positive": 14.0, "negative": 22.0}),
    KnownEffect("viscous_friction", "slide", {"coefficient": 35.0}),
    KnownEffect("viscous_friction", "slide", {"positive": 25.0, "negative": 45.0}),
    KnownEffect("stribeck_friction", "slide", {"static_force": 26.0, "coulomb_force": 16.0, "stribeck_velocity": 0.04}),
    KnownEffect("smooth_coulomb_friction", "slide", {"force": 18.0, "width": 0.15}),
    KnownEffect("smooth_coulomb_friction", "slide", {"force": 18.0, "width": 0.15, "exponent": 1.5}),
    KnownEffect("flexible_drive", "slide", {"frequency": 6.0, "damping_ratio": 0.05, "inertia_ratio": 1.5}),
    KnownEffect("inertia_error", "slide", {"ratio": 1.25}),
    KnownEffect("force_constant_error", "slide", {"ratio": 0.85}),
    KnownEffect("load_bias", "slide", {"force": -4.0}),
    KnownEffect("sensor_scale", "boom.joint", {"scale": 1.02}),
    KnownEffect("sensor_scale", "slew.joint", {"scale": 1.03}),
    KnownEffect("sensor_scale", "boom.cylinder", {"scale": 0.97}),
    KnownEffect("sensor_bias", "boom.joint", {"bias": 0.008}),
    KnownEffect("sensor_bias", "boom.cylinder", {"bias": -0.002}),
    KnownEffect("sensor_quantisation", "boom.joint", {"step": 0.004}),
    KnownEffect("clock_skew", "capture", {"skew": 2000.0}),
    KnownEffect("clock_offset", "capture", {"offset": 0.024}),
)


def label(effect: KnownEffect) -> str:
    """For test names and tables."""
    side = f"-{effect.side}" if effect.side else ""
    form = "-two" if effect.name.endswith("friction") and len(effect.parameters) == 2 else ""
    return f"{effect.name}-{effect.target}{side}{form}"
