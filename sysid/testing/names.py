"""Names that have a fixed meaning, whether or not the catalogue has the effect already."""

from __future__ import annotations

#: By stage. A name is never reused for another meaning.
CONTRACT_NAMES: frozenset[str] = frozenset(
    {
        *("input_delay", "first_order_lag", "valve_deadband", "valve_hysteresis", "gain_error", "asymmetric_gain"),
        *("gain_curve", "flow_saturation", "command_rate_limit", "load_dependent_flow", "pump_flow_limit"),
        *("internal_leakage", "temperature_drift", "stiction", "oil_compressibility"),
        *("coulomb_friction", "viscous_friction", "stribeck_friction", "inertia_error", "load_bias"),
        *("backlash", "joint_compliance"),
        *("joint_offset", "link_length_error", "base_misalignment"),
        *("gripper_sway",),
        *("sensor_bias", "sensor_scale", "sensor_quantisation", "clock_offset", "clock_skew"),
    }
)
