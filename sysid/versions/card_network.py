"""Blocks of the cards of networks and policies: architecture, ranges, limits."""

from __future__ import annotations

from collections.abc import Iterator

from sysid.display import quantity
from sysid.networks import ForwardNetwork, Model, StructuredForward, history_networks, motion_networks, static_networks
from sysid.networks.policy import PolicyNetwork
from sysid.registry import ModelVersion
from sysid.validate import ValidationReport
from sysid.versions.card_block import CardBlock
from sysid.versions.card_report import best_simple
from sysid.versions.outputs import output_maps
from sysid.versions.policy import ROWS

#: Rectifier → text.
RECTIFIERS = {"relu": "", "smooth": ", with smooth rectifiers"}
#: Inputs of a forward network → text.
FEATURES = {
    "joints": "joint values",
    "sincos": "sines and cosines of the angles",
    "products": "products of sines and cosines of the angles",
}


def what_network(model: Model | None) -> Iterator[str]:
    if isinstance(model, StructuredForward):
        from sysid.networks import Calibration

        known = isinstance(model.structure, Calibration)
        yield (
            "The URDF's kinematics with its geometry calibrated." if known else "The products of an open chain, without a URDF."
        )
        if isinstance(model.structure, Calibration) and model.structure.elastic:
            yield "Its joints deflect under the weight of the links."
        if model.members:
            size = "-".join(map(str, model.members[0].hidden))
            yield f"{len(model.members)} perceptrons ({size}) correct its position by at most {quantity(model.bound, 'm')}."
    elif isinstance(model, ForwardNetwork):
        size = "-".join(map(str, model.members[0].hidden))
        many = f"the mean of {len(model.members)} perceptrons" if len(model.members) > 1 else "one perceptron"
        yield f"It is {many} ({size}) of {FEATURES[model.features]}{RECTIFIERS[model.members[0].rectifier]}."
    elif motions := motion_networks(model) if model is not None else {}:
        for axis, network in motions.items():
            seconds, size = network.window.depth * network.window.step, "-".join(map(str, network.members[0].hidden))
            many = f"the mean of {len(network.members)} perceptrons" if len(network.members) > 1 else "one perceptron"
            past = "and past speeds" if len(network.window.edges) > 1 else "alone"
            yield (
                f"{axis}: {many} ({size}), steps of {network.window.step:g} s, {seconds:g} s of commands {past}. "
                "Its inputs are those with the smaller free-run error on the selection recordings."
            )
    elif model is not None:
        for axis, item in history_networks(model).items():
            memories = (item.to_joint, item.to_cylinder)
            unused = [way for way, memory in zip(("joint", "cylinder"), memories, strict=True) if memory.inactive]
            note = f"; not used for {' and '.join(unused)}, where it did not reduce the error" if unused else ""
            yield f"{axis}: a recurrent part of {memories[0].units} units with steps of {memories[0].interval:g} s{note}."
        sizes = (f"{axis} {'-'.join(map(str, network.to_joint.hidden))}" for axis, network in static_networks(model).items())
        yield f"Hidden layers: {', '.join(sizes)}."


def network_ranges(model: Model) -> CardBlock:
    found: dict[str, tuple[str, ...]] = {}
    for answer in output_maps(model):
        for signal, unit, low, high in zip(answer.inputs, answer.units, answer.low, answer.high, strict=True):
            found[signal] = (signal, quantity(low, unit, 4), quantity(high, unit, 4))
    return CardBlock("Ranges that it was fitted on", (), ("input", "from", "to"), tuple(found.values()))


def network_limits(model: Model | None, report: ValidationReport | None) -> Iterator[str]:
    if isinstance(model, StructuredForward):
        yield "Beyond its ranges the geometry extrapolates; the correction by the perceptrons is bounded."
        yield "`spread` gives the uncertainty that the poses leave."
    elif isinstance(model, ForwardNetwork):
        yield "Beyond its ranges it extrapolates without a bound on the error. " + (
            "`spread`, the standard deviation of its members, increases there."
            if len(model.members) > 1
            else "A single member has no spread: its intervals have the same width everywhere."
        )
    elif model is not None and motion_networks(model):
        yield "A free run stays within the fitted speeds and positions; at a new load or speed its error is unknown."
        yield "Its parameters have no physical meaning; for named effects use `sysid gap`."
    elif model is not None and history_networks(model):
        yield "It needs the motion that led to a position; after a gap its state is reset."
        yield "Beyond its ranges its static part extrapolates linearly, and its recurrent part is bounded."
    elif model is not None:
        yield "It is a static map: effects of direction or speed (backlash, hysteresis) are averaged."
        yield "Beyond its ranges it extrapolates linearly."
    if report is not None:
        worse = [
            f"{entry.output} {ROWS[entry.rows]} ({best})"
            for entry in report.outputs
            if (best := best_simple(entry)) is not None and entry.baselines[best].rmse < entry.metrics.rmse
        ]
        if worse:
            yield f"A simple model has a smaller error in: {', '.join(worse)}."
        spikes = sorted(((e, s) for e in report.outputs for s in e.spikes), key=lambda pair: -pair[1].sigmas)
        for entry, spike in spikes[:3]:
            where = f"{spike.time:.2f} s of {spike.recording} ({spike.cause.replace('_', ' ')})"
            yield f"Among its largest errors: {entry.output} {quantity(spike.error, entry.unit)} at {where}."
    yield "The evaluation is of the machine at that time: `sysid validate` with newer recordings tests whether it still fits."


def what_policy(version: ModelVersion, policy: PolicyNetwork) -> Iterator[str]:
    size = "-".join(map(str, policy.mlp.hidden))
    yield f"It is a perceptron ({size}) whose tanh outputs are scaled to the limits of the setpoints."
    recipe = version.lineage.get("recipe", {})
    exploration, learning = recipe.get("exploration", {}), recipe.get("learning", {})
    candidates = exploration.get("candidates", 1)
    how = f"the best of {candidates} candidates by the forward model" if candidates > 1 else "one noisy action a step"
    yield (
        f"DDPG, {learning.get('episodes')} episodes, γ {learning.get('discount')}, batch {learning.get('batch')}, "
        f"explored with {how}; seed {recipe.get('seed')}."
    )


def policy_ranges(policy: PolicyNetwork) -> CardBlock:
    middle, half = policy.mlp.inputs.mean, policy.mlp.inputs.scale
    rows = [
        ("observed", name, f"{low:.4g}", f"{high:.4g}")
        for name, low, high in zip(policy.inputs, middle - half, middle + half, strict=True)
    ]
    rows += [
        ("setpoint", name, f"{low:.4g}", f"{high:.4g}")
        for name, low, high in zip(policy.outputs, policy.low, policy.high, strict=True)
    ]
    return CardBlock("Ranges", ("In rad, m and their rates.",), ("", "signal", "from", "to"), tuple(rows))


def policy_limits(policy: PolicyNetwork) -> Iterator[str]:
    yield "Setpoints stay within their limits for any observation; beyond the ranges their quality is unknown."
    if not policy.full:
        yield "It was trained with joints that follow at once and without sway: delay, lag and sway of the machine add errors."
    yield "Its baseline is bounded least-squares inverse kinematics on the calibrated geometry: `sysid track` compares them."
