"""What a card says of a network: what it is, the ranges that it learned from, where it may be trusted."""

from __future__ import annotations

from collections.abc import Iterator

from sysid.networks import ForwardNetwork, Model, StructuredForward, history_networks, motion_networks, static_networks
from sysid.validate import ValidationReport
from sysid.versions.card_block import CardBlock
from sysid.versions.card_report import best_simple
from sysid.versions.outputs import output_maps, shown
from sysid.versions.policy import ROWS

#: How its layers bend.
CORNERS = {"relu": "", "smooth": ", with smooth rectifiers"}
#: What enters a forward network.
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
        if model.members:
            size = "-".join(map(str, model.members[0].hidden))
            yield f"{len(model.members)} perceptrons ({size}) correct it by at most {shown(model.bound, 'm')}."
    elif isinstance(model, ForwardNetwork):
        size = "-".join(map(str, model.members[0].hidden))
        many = f"the mean of {len(model.members)} perceptrons" if len(model.members) > 1 else "one perceptron"
        yield f"It is {many} ({size}) of {FEATURES[model.features]}{CORNERS[model.members[0].rectifier]}."
    elif motions := motion_networks(model) if model is not None else {}:
        for axis, network in motions.items():
            seconds, size = network.window.depth * network.window.step, "-".join(map(str, network.members[0].hidden))
            many = f"the mean of {len(network.members)} perceptrons" if len(network.members) > 1 else "one perceptron"
            past = "and past speeds" if len(network.window.edges) > 1 else "alone"
            yield (
                f"{axis}: {many} ({size}), steps of {network.window.step:g} s, {seconds:g} s of commands {past}. "
                "Its inputs are those with the better free runs on the recordings to select."
            )
    elif model is not None:
        for axis, item in history_networks(model).items():
            memories = (item.to_joint, item.to_cylinder)
            quiet = [way for way, memory in zip(("joint", "cylinder"), memories, strict=True) if memory.inactive]
            said = f"; silent towards {' and '.join(quiet)}, where it did not help" if quiet else ""
            yield f"{axis}: a memory of {memories[0].units} units that looks every {memories[0].interval:g} s{said}."
        sizes = (f"{axis} {'-'.join(map(str, network.to_joint.hidden))}" for axis, network in static_networks(model).items())
        yield f"Hidden layers: {', '.join(sizes)}."


def network_ranges(model: Model) -> CardBlock:
    found: dict[str, tuple[str, ...]] = {}
    for answer in output_maps(model):
        for signal, unit, low, high in zip(answer.inputs, answer.units, answer.low, answer.high, strict=True):
            found[signal] = (signal, f"{low:.4g}", f"{high:.4g}", unit)
    return CardBlock("Ranges that it was fitted on", (), ("input", "from", "to", "unit"), tuple(found.values()))


def network_limits(model: Model | None, report: ValidationReport | None) -> Iterator[str]:
    if isinstance(model, StructuredForward):
        yield "Beyond its ranges the geometry goes on to hold; what the perceptrons add is bounded."
        yield "`spread` says what the poses leave open."
    elif isinstance(model, ForwardNetwork):
        yield "Beyond its ranges it guesses. " + (
            "`spread`, the scatter of its members, grows where they do."
            if len(model.members) > 1
            else "A single member has no scatter: its intervals are as wide everywhere."
        )
    elif model is not None and motion_networks(model):
        yield "A free run stays within the speeds and positions that it learned from; at a new load or speed it guesses."
        yield "It has no parameters that mean anything: `sysid gap` names what a simulation lacks."
    elif model is not None and history_networks(model):
        yield "It needs the motion that led to a position; after a gap it begins anew, knowing nothing."
        yield "Beyond its ranges its static part goes on in straight lines, and its memory adds no more than it learned."
    elif model is not None:
        yield "It is a static map: what depends on direction or speed (backlash, hysteresis) is averaged."
        yield "Beyond its ranges it goes on in straight lines."
    if report is not None:
        worse = [
            f"{entry.output} {ROWS[entry.rows]} ({best})"
            for entry in report.outputs
            if (best := best_simple(entry)) is not None and entry.baselines[best].rmse < entry.metrics.rmse
        ]
        if worse:
            yield f"A simple model is as good or better in: {', '.join(worse)}."
        spikes = sorted(((e, s) for e in report.outputs for s in e.spikes), key=lambda pair: -pair[1].sigmas)
        for entry, spike in spikes[:3]:
            where = f"{spike.time:.2f} s of {spike.recording} ({spike.cause.replace('_', ' ')})"
            yield f"Among its largest errors: {entry.output} {shown(spike.error, entry.unit)} at {where}."
    yield "It was evaluated on the machine as it was then: `sysid validate` with newer recordings says whether it still fits."
