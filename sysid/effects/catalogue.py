"""The list of effects, in the physical order in which the chain applies them."""

from __future__ import annotations

from sysid.effects import (
    armature_error,
    asymmetric_gain,
    backlash,
    base_misalignment,
    clock_offset,
    clock_skew,
    command_rate_limit,
    coulomb_friction,
    damping_error,
    first_order_lag,
    flexible_drive,
    flow_saturation,
    force_constant_error,
    force_limit,
    gain_curve,
    gain_error,
    gripper_sway,
    inertia_error,
    inertial_error,
    input_delay,
    internal_leakage,
    joint_compliance,
    joint_offset,
    link_length_error,
    link_mass_error,
    load_bias,
    load_dependent_flow,
    load_dependent_friction,
    oil_compressibility,
    payload,
    pump_flow_limit,
    second_order_lag,
    sensor_bias,
    sensor_quantisation,
    sensor_scale,
    smooth_coulomb_friction,
    stiction,
    stiffness_error,
    stribeck_friction,
    temperature_drift,
    tip_offset,
    valve_deadband,
    valve_hysteresis,
    viscous_friction,
)
from sysid.effects.effect import Effect, Form
from sysid.errors import SettingsError, nearest

CATALOGUE: tuple[Effect, ...] = (
    input_delay.EFFECT,
    valve_hysteresis.EFFECT,
    valve_deadband.EFFECT,
    gain_curve.EFFECT,
    flow_saturation.EFFECT,
    command_rate_limit.EFFECT,
    first_order_lag.EFFECT,
    second_order_lag.EFFECT,
    gain_error.EFFECT,
    asymmetric_gain.EFFECT,
    temperature_drift.EFFECT,
    load_dependent_flow.EFFECT,
    internal_leakage.EFFECT,
    stiction.EFFECT,
    oil_compressibility.EFFECT,
    pump_flow_limit.EFFECT,
    stiffness_error.EFFECT,
    damping_error.EFFECT,
    force_limit.EFFECT,
    force_constant_error.EFFECT,
    coulomb_friction.EFFECT,
    viscous_friction.EFFECT,
    stribeck_friction.EFFECT,
    smooth_coulomb_friction.EFFECT,
    load_dependent_friction.EFFECT,
    inertia_error.EFFECT,
    armature_error.EFFECT,
    flexible_drive.EFFECT,
    load_bias.EFFECT,
    link_mass_error.EFFECT,
    inertial_error.EFFECT,
    backlash.EFFECT,
    joint_compliance.EFFECT,
    joint_offset.EFFECT,
    link_length_error.EFFECT,
    tip_offset.EFFECT,
    base_misalignment.EFFECT,
    gripper_sway.EFFECT,
    payload.EFFECT,
    sensor_scale.EFFECT,
    sensor_bias.EFFECT,
    sensor_quantisation.EFFECT,
    clock_skew.EFFECT,
    clock_offset.EFFECT,
)

BY_NAME: dict[str, Effect] = {effect.name: effect for effect in CATALOGUE}


def effect_named(name: str, where: object = "effect") -> Effect:
    """The effect called ``name``.

    Raises:
        SettingsError: no effect has that name.
    """
    if name not in BY_NAME:
        raise SettingsError(where, f"unknown effect {name!r}", nearest(name, BY_NAME))
    return BY_NAME[name]


def confusions(effect: Effect) -> dict[str, str]:
    """Effects similar to this one → what separates the two, from either file."""
    from_others = {e.name: e.confused_with[effect.name] for e in CATALOGUE if effect.name in e.confused_with}
    return {**effect.confused_with, **from_others}


def form_for(effect: Effect, parameters: frozenset[str], where: object) -> Form:
    """The form of ``effect`` that has exactly these parameters.

    Raises:
        SettingsError: a parameter is unknown or missing.
    """
    form = effect.form_of(parameters)
    if form is None:
        forms = " or ".join("{" + ", ".join(form.names) + "}" for form in effect.forms)
        valid = {name for form in effect.forms for name in form.names}
        unknown = sorted(parameters - valid)
        remedy = f"{unknown[0]!r} is no parameter: {nearest(unknown[0], valid)}" if unknown else ""
        raise SettingsError(f"{where}: {effect.name}", f"parameters {{{', '.join(sorted(parameters))}}}", forms, remedy)
    return form
