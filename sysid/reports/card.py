"""The card of a model version: purpose, errors beside simple models, ranges, limits, provenance, loading; and what it changes
against the version before, in its predictions or its effects. As Markdown (as HTML: :mod:`sysid.reports.model_pages`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from sysid.display import NOTHING, interval, minute, percent, quantity
from sysid.figures import ErrorFigure, Table, output_name, stored_parameters
from sysid.gap.result import Gap
from sysid.networks import ForwardNetwork, Model, StructuredForward, history_networks, motion_networks, static_networks
from sysid.networks.policy import PolicyNetwork
from sysid.networks.uncertainty import FALSE_FLAGS
from sysid.registry import NETWORKS, ModelVersion
from sysid.registry.effect_changes import CHANGES, change_cells
from sysid.registry.promotion import decision_row
from sysid.reports.result_figures import (
    PREDICTIONS,
    largest_spikes,
    network_error,
    point_errors,
    prediction_cells,
    spike_sentence,
)
from sysid.reports.words import effect_title
from sysid.signals import POINTS, point_signals
from sysid.validate import ErrorMap, ValidationReport
from sysid.versions.diff import ModelDiff
from sysid.versions.lineage import ModelLineage
from sysid.versions.outputs import output_maps


@dataclass(frozen=True)
class CardBlock:
    """One section of a card: paragraphs, a table, code, error maps (output, unit, map); any of them may be empty."""

    title: str
    text: tuple[str, ...] = ()
    table: Table = field(default_factory=Table)
    code: str = ""
    maps: tuple[tuple[str, str, ErrorMap], ...] = ()


@dataclass(frozen=True)
class Card:
    """A card; ``facts`` is the line under its title."""

    title: str
    facts: str
    blocks: tuple[CardBlock, ...]

    def markdown(self) -> str:
        """The card as Markdown."""
        parts = [f"# {self.title}", self.facts]
        for block in self.blocks:
            parts += [f"## {block.title}", *block.text]
            if block.table.rows:
                parts.append(block.table.markdown())
            if block.code:
                parts.append(f"```python\n{block.code}\n```")
        return "\n\n".join(parts) + "\n"


#: Maps per output on the page.
MAPS_SHOWN = 2
#: Fewest rows of a region whose coverage is given.
MIN_REGION_ROWS = 20


def figures(report: ValidationReport) -> CardBlock:
    rows = []
    for entry in map(network_error, report.outputs):
        best = entry.best_simple
        floor = NOTHING if entry.noise_floor is None else quantity(entry.noise_floor, entry.unit)
        simple = f"{best} {quantity(entry.baselines[best], entry.unit)}" if best else NOTHING
        rows.append((output_name(entry), *entry.texts, floor, simple))
    recordings = dict.fromkeys(name for entry in report.outputs for name in entry.recordings)
    text = f"On held-out rows of {report.dataset} ({', '.join(recordings)})."
    header = ("output", "RMSE", "95 %", "max", "sensor noise alone", "best simple model")
    return CardBlock("Figures", tuple(filter(None, (text, report.recommendation))), Table(header, rows))


def baselines(report: ValidationReport) -> CardBlock:
    """The RMSE of the network and of every simple model."""
    entries = [network_error(entry) for entry in report.outputs]
    names = list(dict.fromkeys(name for entry in entries for name in entry.baselines))
    rows = [
        (
            output_name(entry),
            quantity(entry.rmse, entry.unit),
            *(quantity(entry.baselines[name], entry.unit) if name in entry.baselines else NOTHING for name in names),
        )
        for entry in entries
        if names
    ]
    text = ("RMSE; all fitted on the same rows.",)
    return CardBlock("Beside simple models", text, Table(("output", "this version", *names), rows))


def error_maps(report: ValidationReport) -> CardBlock:
    """The worst bin of the first map of each output; the maps are shown on the page."""
    rows, maps = [], []
    for entry in report.outputs:
        maps += [(output_name(entry), entry.unit, item) for item in entry.maps[:MAPS_SHOWN]]
        for first in entry.maps[:1]:
            a, b = first.worst
            ends = (
                f"{name} {interval(edges[k], edges[k + 1], unit)}"
                for name, unit, edges, k in zip(first.over, first.units, first.edges, (a, b), strict=True)
            )
            size, count = quantity(first.rmse[a][b], entry.unit), first.count[a][b]
            rows.append((output_name(entry), ", ".join(ends), size, count, percent(first.explains)))
    header = ("output", "largest where", "RMSE there", "rows", "explained by the map")
    return CardBlock("Where its errors are", (), Table(header, rows), maps=tuple(maps))


def uncertainty(report: ValidationReport) -> CardBlock:
    """Coverage of its intervals, and how often it flags extrapolation."""
    rows, level = [], 0.0
    for entry in report.outputs:
        if (found := entry.coverage) is None:
            continue
        level = level or found.level
        crowded = [region for region in found.regions if region.count >= MIN_REGION_ROWS]
        worst = min(crowded, key=lambda region: region.covered, default=None)
        rows.append(
            (
                output_name(entry),
                f"± {quantity(found.half_width, entry.unit)}",
                f"{100.0 * found.covered:.1f} %",
                NOTHING if worst is None else f"{worst.name}: {100.0 * worst.covered:.0f} %",
                f"{100.0 * found.flagged:.1f} %",
            )
        )
    text = (
        f"Its {100.0 * level:g} % intervals (`predict_interval`) on held-out rows, and the share of rows that it flags as "
        f"extrapolation (`inside`; of rows from the training distribution {100.0 * FALSE_FLAGS:g} %)."
    )
    return CardBlock(
        "Uncertainty", (text,), Table(("output", "half width, median", "coverage", "lowest coverage", "flagged"), rows)
    )


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
    return CardBlock("Ranges that it was fitted on", (), Table(("input", "from", "to"), list(found.values())))


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
            f"{output_name(entry)} ({best})"
            for entry in map(network_error, report.outputs)
            if (best := entry.best_simple) and entry.baselines[best] < entry.rmse
        ]
        if worse:
            yield f"A simple model has a smaller error in: {', '.join(worse)}."
        for entry, spike in largest_spikes(report)[:3]:
            yield f"Among its largest errors: {spike_sentence(entry, spike)}."
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
    return CardBlock("Ranges", ("In rad, m and their rates.",), Table(("", "signal", "from", "to"), rows))


def policy_limits(policy: PolicyNetwork) -> Iterator[str]:
    yield "Setpoints stay within their limits for any observation; beyond the ranges their quality is unknown."
    if not policy.full:
        yield "It was trained with joints that follow at once and without sway: delay, lag and sway of the machine add errors."
    yield "Its baseline is bounded least-squares inverse kinematics on the calibrated geometry: `sysid track` compares them."


def changes(found: ModelDiff) -> CardBlock | None:
    """Predictions of networks, effects of plants; None for other kinds."""
    title = f"Changed since {found.before}"
    if found.predictions:
        about = "Difference of the predictions over the range that both versions were fitted on."
        return CardBlock(title, (about,), Table(PREDICTIONS, list(map(prediction_cells, found.predictions))))
    if found.kind == "plant":
        changed = [change for change in found.effects if change.before is not None or change.after is None]
        if found.effects and not changed:  # all are new, and are listed with their values
            return None
        same = () if changed else ("The effects are the same.",)
        return CardBlock(title, same, Table(CHANGES, [change_cells(change, effect_title) for change in changed]))
    return None


#: Kinds that `sysid models export` writes: networks without history.
EXPORTED = ("actuator", "motion", "forward")
DESCRIPTIONS = {
    "actuator": "Actuator networks: cylinder displacement to joint angle and back, one perceptron per direction and axis.",
    "history": "Actuator networks with history: cylinder displacement to joint angle and back along a motion; a static "
    "perceptron and a recurrent part per direction and axis.",
    "motion": "Command to motion: the history of command and speed, and the position, to the next speed of an axis.",
    "forward": "Forward model: joint values to the position of the end effector in the machine's base frame.",
    "plant": "Plant: the simulation of a machine, commands to motion, with named effects.",
    "policy": "Policy: joints, end effector and target to joint setpoints, trained on a plant.",
}


def card_of(
    version: ModelVersion,
    lineage: ModelLineage,
    model: Model | None = None,
    report: ValidationReport | None = None,
    policy: PolicyNetwork | None = None,
    units: Mapping[str, str] | None = None,
) -> Card:
    """The card of a version.

    Args:
        units: signal → SI unit in its dataset, for the errors of a plant.
        model: the network in it; None for plants and policies.
        report: its evaluation on the held-out rows of its own dataset; None if that is not available.
        policy: the policy in it; None for other kinds.
    """
    aliases = f" ({', '.join(version.aliases)})" if version.aliases else ""
    details = what_policy(version, policy) if policy is not None else what_network(model)
    limits = policy_limits(policy) if policy is not None else network_limits(model, report)
    blocks = [CardBlock("What it is", (DESCRIPTIONS.get(version.kind, version.kind), *details))]
    if report is not None:
        blocks += [figures(report), *_with_rows(baselines(report), error_maps(report), uncertainty(report))]
    elif version.metrics:
        rows = [(name, f"{value:.4g}") for name, value in version.metrics.items()]
        what = "the actor alone, from random poses to random targets (reach), then staying there (hold)"
        text = (f"As stored with it, in SI units; {what if policy else 'its dataset is not available'}.",)
        blocks.append(CardBlock("Figures", text, Table(("figure", "value"), rows)))
    if version.kind == "plant":
        blocks += _with_rows(_errors(version.lineage, units or {}), _effects(version.lineage))
    if model is not None:
        blocks.append(network_ranges(model))
    if policy is not None:
        blocks.append(policy_ranges(policy))
    decisions = Table(("when", "decision", "by", "reason"), list(map(decision_row, version.decisions[::-1])))
    blocks += [
        CardBlock("Limits", tuple(limits)),
        _lineage(lineage),
        *_with_rows(CardBlock("Decisions", (), decisions)),
        CardBlock("Files", (), Table(("file", "sha256"), sorted(version.sha256.items()))),
        CardBlock("How to load it", tuple(_loading(version)), code=_code(version)),
    ]
    facts = f"{version.kind}{aliases}, made {minute(version.created_ms)} UTC, content {version.digest[:12]}"
    return Card(version.reference, facts, tuple(blocks))


def _with_rows(*blocks: CardBlock) -> list[CardBlock]:
    return [block for block in blocks if block.table.rows]


def _lineage(found: ModelLineage) -> CardBlock:
    rows: list[tuple[str, ...]] = []
    if found.dataset:
        rows.append(("made from", found.dataset, "dataset", found.dataset_digest[:12]))
    if found.source is not None:
        files = [source for part in found.source.parts for source in part.sources]
        rows += [("raw file", source.path, f"{source.size} bytes", source.sha256[:12]) for source in files]
    rows += [("made from", item.reference, item.kind, item.digest[:12]) for item in found.parents]
    rows += [("used by", item.reference, item.kind, item.digest[:12]) for item in found.children]
    rows += [("used by", use.what, use.how, f"on {use.dataset}") for use in found.uses]
    return CardBlock("Lineage", (found.missing,) if found.missing else (), Table(("", "what", "kind", "content"), rows))


def _effects(lineage: Mapping[str, Any]) -> CardBlock:
    """One row for each parameter of the added effects, with its interval."""
    rows = []
    for effect in lineage.get("effects", ()):
        place = effect_title(str(effect.get("name"))), str(effect.get("target"))
        share = percent(effect.get("closed_share", math.nan))
        own = [(figure.label, figure.text, figure.interval) for figure in stored_parameters(effect)]
        for values in own or [("", "", "")]:
            rows.append((*place, *values, share))
            place, share = ("", ""), ""
    header = ("effect", "on", "parameter", "value", "95 % interval", "share of the gap closed")
    return CardBlock("Added effects", (), Table(header, rows))


def plant_errors(lineage: Mapping[str, Any], units: Mapping[str, str]) -> list[ErrorFigure]:
    """Held-out errors that the lineage of a repaired plant states: of points, and of signals whose unit is known."""
    stored = (lineage.get("proof") or {}).get("gap")
    if not stored:
        return []
    known = {key: {name: value for name, value in own.items() if value is not None} for key, own in stored.items()}
    names = {name: unit for name, unit in units.items() if name in known["before"]}
    names |= {name: "m" for point in POINTS for name in point_signals(point)}
    gap = Gap(*({name: v for name, v in known[key].items() if name in names} for key in ("before", "after", "noise_floor")))
    return point_errors(gap, names)


def _errors(lineage: Mapping[str, Any], units: Mapping[str, str]) -> CardBlock:
    """The held-out error before and after the repair."""
    rows = [(figure.name, *figure.texts, percent(figure.closed)) for figure in plant_errors(lineage, units)]
    held_out = (lineage.get("recordings") or {}).get("held_out", ())
    text = f"RMS over the held-out recordings of {lineage.get('dataset')} ({', '.join(held_out)}), from the commands alone."
    header = ("", f"before: {lineage.get('plant')}", "this version", "noise floor", "closed")
    return CardBlock("Error", (text,), Table(header, rows))


def _loading(version: ModelVersion) -> Iterator[str]:
    yield f"`name@version` never changes; `{version.name}` alone refers to the champion, or to the newest if none was promoted."
    if version.kind in (*EXPORTED, "policy"):
        yield f"Without Python: `sysid models export {version.reference}` writes ONNX files."


def _code(version: ModelVersion) -> str:
    call = (
        f'network("{version.reference}")'
        if version.kind in NETWORKS
        else f'policy("{version.reference}")'
        if version.kind == "policy"
        else f'models.load("{version.reference}").files'
    )
    use = {
        "forward": "model.predict(q)  # (n, n_axes) [rad or m] → (n, 3) [m]",
        "policy": "model.act(observations)  # (n, n_observed) → (n, n_axes) [rad or m]",
        "history": "model[axis].joint_along(displacement, rate_hz)  # (n,) → (n,); .joint_stream(rate_hz).step(value)",
        "motion": "model[axis].free_run(recording)  # (n,); .stream(position).step(command) moves it step by step",
        "actuator": "model[axis].joint(displacement)  # [m] → [rad]; .displacement(joint) goes back",
    }.get(version.kind, "")
    lines = ["from sysid.workspace import open_workspace", "", f'model = open_workspace("./workspace").{call}', use]
    return "\n".join(line for line in lines if line or line is lines[1]).rstrip()
