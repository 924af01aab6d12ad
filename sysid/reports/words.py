"""Effects, stages and verdicts in the words of a hydraulics engineer."""

from __future__ import annotations

import string
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Words:
    """``sentences``: templates over ``{target}`` and the parameters; the first one whose parameters are all known is used.

    ``beside``: another effect on the same target → the sentence where that one changes what this one's value means.
    """

    title: str
    sentences: tuple[str, ...]
    beside: Mapping[str, str] = field(default_factory=dict)


EFFECTS: dict[str, Words] = {
    "input_delay": Words("Dead time", ("The {target} starts to react only {delay} after the command.",)),
    "first_order_lag": Words("Valve lag", ("The {target} follows its command with a lag of {time_constant}.",)),
    "valve_deadband": Words(
        "Valve dead-band",
        ("The {target} does not move until its command exceeds +{positive} in one direction or −{negative} in the other.",),
    ),
    "valve_hysteresis": Words("Spool hysteresis", ("The spool of the {target} lags its command by a play of {width}.",)),
    "gain_error": Words(
        "Wrong speed gain",
        ("The {target} moves at {ratio} times the speed that the simulation assumes.",),
        {"valve_deadband": "Beyond its dead-band the {target} answers {ratio} times as steeply as the simulation assumes."},
    ),
    "asymmetric_gain": Words(
        "Unequal speeds", ("The {target} moves {ratio} times as fast in the negative direction as in the positive one.",)
    ),
    "gain_curve": Words("Curved valve gain", ("The speed of the {target} follows its command to the power of {exponent}.",)),
    "flow_saturation": Words("Flow saturation", ("The {target} gets no faster beyond a command of {limit}.",)),
    "command_rate_limit": Words("Command rate limit", ("The command of the {target} changes by at most {rate} a second.",)),
    "load_dependent_flow": Words(
        "Load-dependent flow",
        ("The load changes the speed of the {target}: slower against it, faster with it ({coefficient}).",),
    ),
    "pump_flow_limit": Words("Pump flow limit", ("The pump feeds at most {limit} full-speed axes at once.",)),
    "internal_leakage": Words("Internal leakage", ("With its valve closed the {target} creeps by {rate} a second.",)),
    "temperature_drift": Words("Warm-up drift", ("As the oil warms up, the speed of the {target} drifts by {fraction}.",)),
    "stiction": Words(
        "Stiction",
        (
            "The {target} sticks until its command reaches {breakaway} and stops again at {release}.",
            "The {target} sticks until its command reaches {breakaway}.",
        ),
    ),
    "oil_compressibility": Words("Oil spring", ("The {target} rings at {frequency} on the compressed oil.",)),
    "coulomb_friction": Words(
        "Dry friction",
        (
            "Dry friction of {force} acts against the motion of the {target}.",
            "Dry friction of {positive} (forwards) and {negative} (backwards) acts against the motion of the {target}.",
        ),
    ),
    "viscous_friction": Words(
        "Viscous friction",
        (
            "The {target} is braked by friction in proportion to its speed ({coefficient}).",
            "The {target} is braked in proportion to its speed, by {positive} forwards and {negative} backwards.",
        ),
    ),
    "stribeck_friction": Words(
        "Stribeck friction", ("The friction of the {target} falls from {static_force} to {coulomb_force}.",)
    ),
    "inertia_error": Words("Wrong inertia", ("The {target} is {ratio} times as heavy as the simulation assumes.",)),
    "load_bias": Words("Constant load", ("A constant load of {force} acts on the {target}.",)),
    "backlash": Words(
        "Backlash", ("The {target} has a play of {width}: at each reversal its drive moves and the joint waits.",)
    ),
    "joint_compliance": Words("Joint compliance", ("The {target} gives way under the weight that it carries ({compliance}).",)),
    "joint_offset": Words("Joint zero offset", ("The zero of the {target} joint is off by {offset}.",)),
    "link_length_error": Words("Link length error", ("The link moved by the {target} is {error} longer than described.",)),
    "base_misalignment": Words(
        "Base misalignment", ("The machine's base and the measuring frame are not where the survey says.",)
    ),
    "gripper_sway": Words(
        "Swinging tool",
        (
            "The tool swings on a pendulum of {length} (damping ratio {damping_ratio}); the simulation keeps it still.",
            "The tool swings on a pendulum of {length}; the simulation keeps it still.",
        ),
    ),
    "sensor_bias": Words("Sensor bias", ("The sensor {target} reads {bias} too much.",)),
    "sensor_scale": Words("Sensor scale", ("The sensor {target} reads {scale} times the true value.",)),
    "sensor_quantisation": Words("Sensor resolution", ("The sensor {target} moves in steps of {step}.",)),
    "clock_offset": Words("Clock offset", ("The clock of {target} is off by {offset}.",)),
    "clock_skew": Words("Clock skew", ("The clock of {target} runs at a different rate ({skew} ppm).",)),
}

#: Stage → what is compared, in the order of the signal chain.
STAGES: dict[str, tuple[str, str]] = {
    "command": ("Command → actuator", "driven by the recorded command"),
    "force": ("Force → motion", "force that the measured motion needs"),
    "joint": ("Actuator → joint", "driven by the measured actuator"),
    "end_effector": ("Joints → tip", "driven by the measured joints"),
    "tool": ("Tip → tool", "driven by the measured tip"),
}

OWNERS = {"ee": "boom tip", "tool": "tool", "machine": "whole machine", "base": "base"}

HEADLINES = {
    "no_gap": "The simulation agrees with the machine to within sensor noise.",
    "unnamed": "Something is missing from the simulation that none of the known effects explains.",
    "ambiguous": "The cause is narrowed down, but these recordings cannot tell the remaining candidates apart.",
    "insufficient_excitation": "Simulation and machine disagree, but these recordings lack what is needed to say why.",
}

ADVICE = {
    "no_gap": "Nothing was added. Another motion may still show one: see below what these recordings could not show.",
    "unnamed": "No name was given, because a wrong one is worse than none. What is known about the remainder is listed below.",
    "ambiguous": "Nothing was guessed. The recording that would break the tie is described under “What to record next”.",
    "insufficient_excitation": "The recordings that would settle it are described under “What to record next”.",
}

_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")


def effect_title(name: str) -> str:
    return EFFECTS[name].title if name in EFFECTS else name.replace("_", " ").capitalize()


def effect_sentence(name: str, target: str, parameters: Mapping[str, str], beside: Collection[str] = ()) -> str:
    """One sentence about a named effect.

    Args:
        parameters: already formatted with their units.
        beside: what else was named on the same target.
    """
    values = {"target": owner_name(target), **parameters}
    known = EFFECTS.get(name, Words("", ()))
    for template in (*(text for other, text in known.beside.items() if other in beside), *known.sentences):
        if {field for _, field, _, _ in string.Formatter().parse(template) if field} <= set(values):
            return template.format(**values)
    listed = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in parameters.items())
    return f"{effect_title(name)} of the {values['target']}: {listed}."


def owner_name(target: str) -> str:
    return OWNERS.get(target, target)


def signal_name(signal: str) -> str:
    """``boom.cylinder`` → ``boom cylinder``; ``ee.x`` → ``boom tip x``."""
    owner, _, quantity = signal.rpartition(".")
    return f"{owner_name(owner)} {quantity}"


def stage_name(stage: str) -> str:
    return STAGES[stage][0] if stage in STAGES else stage.replace("_", " ").capitalize()


def localised(places: list[str]) -> str:
    """Where the stages disagree, as a sentence."""
    if not places:
        return "At every stage the simulation agrees with the machine to within sensor noise."
    listed = ", ".join(places[:4]) + (f" and {len(places) - 4} more" if len(places) > 4 else "")
    return f"Simulation and machine disagree at: {listed}."


def headline(verdict: str, effects: int) -> str:
    """The verdict as a sentence."""
    if verdict != "named":
        return HEADLINES.get(verdict, verdict)
    count = _COUNTS[effects] if effects < len(_COUNTS) else str(effects)
    return f"{count} effect{' is' if effects == 1 else 's are'} missing from the simulation."
