"""What tells two effects apart that look alike. The catalogue's pages print it."""

from __future__ import annotations

_PAIRS: tuple[tuple[str, str, str], ...] = (
    ("asymmetric_gain", "load_dependent_flow", "speed ratio up/down over gravity moment: its value at no moment, its slope"),
    ("asymmetric_gain", "valve_deadband", "a ratio of speeds grows with the command; unequal dead-bands shift by a constant"),
    ("asymmetric_gain", "gain_error", "one direction alone, or both alike"),
    ("backlash", "valve_deadband", "the cylinder moves and the joint waits a fixed distance; a dead-band stops both"),
    ("backlash", "stiction", "play costs a distance at each reversal; stiction costs a command at each start"),
    ("backlash", "valve_hysteresis", "play of positions shows at the joint alone; play of commands at the speed of the drive"),
    (
        "base_misalignment",
        "joint_offset",
        "the error is sinusoidal in slew; that of an offset is tangential and grows with reach",
    ),
    ("base_misalignment", "link_length_error", "the error is fixed in space; that of a length follows the link"),
    (
        "command_rate_limit",
        "first_order_lag",
        "a plateau of acceleration at large steps; a lag rises in proportion to the step",
    ),
    ("command_rate_limit", "flow_saturation", "a plateau of acceleration; saturation is a plateau of speed"),
    ("coulomb_friction", "stribeck_friction", "the force is the same at every speed; Stribeck's falls as motion begins"),
    ("coulomb_friction", "load_bias", "friction changes its sign with the motion, a load does not"),
    ("coulomb_friction", "viscous_friction", "constant over speed, or in proportion to it: two speeds tell"),
    ("first_order_lag", "input_delay", "a delay has phase linear in frequency at flat gain; a lag smooths as well"),
    ("first_order_lag", "valve_hysteresis", "the loop of a hysteresis has the same width at any rate; that of a lag grows"),
    (
        "flow_saturation",
        "pump_flow_limit",
        "the plateau is there when the axis moves alone; a pump's only when others move too",
    ),
    ("flow_saturation", "gain_curve", "a corner and a plateau, or a smooth bend"),
    ("gain_curve", "valve_deadband", "at mid commands: an offset line, or a curve through the origin"),
    ("gain_curve", "gain_error", "a gain changes all speeds by one ratio, a curve the low ones most"),
    ("gain_error", "temperature_drift", "constant over the session, or creeping: the same motion early and late"),
    ("gain_error", "sensor_scale", "a scaled sensor also disagrees with every other sensor of the same motion"),
    ("gripper_sway", "oil_compressibility", "0.9–1.3 Hz that goes on after the joints stop, or 5–13 Hz of the axis itself"),
    ("inertia_error", "viscous_friction", "force in phase with acceleration, or with speed"),
    ("input_delay", "clock_offset", "an offset shifts every channel of one device alike, those without a command too"),
    ("input_delay", "valve_hysteresis", "a delay is a time at any amplitude; a hysteresis loses a fixed part of the command"),
    ("internal_leakage", "sensor_bias", "leakage creeps as long as the axis rests; a bias is there at once"),
    ("internal_leakage", "load_dependent_flow", "leakage acts at zero command; load-dependent flow needs flow"),
    ("joint_offset", "link_length_error", "tangential and growing with reach, or radial"),
    ("joint_offset", "joint_compliance", "sag changes with the gravity moment, not only with the angle"),
    ("joint_offset", "load_bias", "an offset moves the tip; a load moves the force"),
    (
        "stiction",
        "valve_deadband",
        "a dead-band starts and stops at one command; stiction starts higher than it stops, and jumps",
    ),
    ("stribeck_friction", "viscous_friction", "a force that falls and then rises with speed, or only rises"),
    (
        "clock_offset",
        "clock_skew",
        "constant over a recording, or growing with it: motion early and late",
    ),
    (
        "clock_offset",
        "first_order_lag",
        "an offset shifts without smoothing, and channels without a command too",
    ),
    (
        "clock_skew",
        "input_delay",
        "grows over the recording; a delay stays",
    ),
    (
        "joint_compliance",
        "link_length_error",
        "sag follows the gravity moment, downwards; a length error follows the link",
    ),
    (
        "backlash",
        "joint_compliance",
        "play turns with the direction of motion; sag with the load, at rest too",
    ),
    (
        "load_dependent_flow",
        "temperature_drift",
        "follows the pose, or the time of the session: the same motion early and late",
    ),
    (
        "first_order_lag",
        "oil_compressibility",
        "a lag never overshoots; oil rings, and moves on after the command stops",
    ),
    (
        "input_delay",
        "oil_compressibility",
        "a delay never overshoots; oil rings at its own frequency",
    ),
    (
        "gain_error",
        "pump_flow_limit",
        "slower at all times, or only while other axes move",
    ),
    (
        "joint_offset",
        "sensor_bias",
        "a biased joint sensor also disagrees with the cylinder through the linkage; an offset with the structure alone",
    ),
    (
        "base_misalignment",
        "sensor_bias",
        "a shift of a measured point cannot be told from one of the base: it is reported as the base's",
    ),
    (
        "sensor_bias",
        "sensor_scale",
        "the same everywhere, or growing with the reading",
    ),
    (
        "sensor_quantisation",
        "stiction",
        "the reading stands still while every other sensor moves on; stiction stops the motion itself",
    ),
    (
        "backlash",
        "sensor_quantisation",
        "steps at fixed readings, or a wait at each reversal",
    ),
    (
        "link_length_error",
        "sensor_scale",
        "in proportion to a reading, or fixed along a link",
    ),
)

SEPARATORS: dict[frozenset[str], str] = {frozenset(pair[:2]): pair[2] for pair in _PAIRS}


def separator(one: str, other: str) -> str:
    """What separates two effects; empty where nothing is written down."""
    return SEPARATORS.get(frozenset((one, other)), "")
