"""The card of a model version: what it is, what it reaches beside simple models, where it holds, whence it came, how to load.

Everything in it is generated; it is Markdown here and a page in :mod:`sysid.reports.model_pages`, both from the same blocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sysid.networks import ForwardNetwork, Model, StructuredForward, history_networks, motion_networks, static_networks
from sysid.networks.policy import PolicyNetwork
from sysid.networks.trust import FALSE_FLAGS
from sysid.registry import NETWORKS, Decision, ModelVersion
from sysid.validate import ErrorMap, OutputReport, ValidationReport
from sysid.versions.lineage import ModelLineage
from sysid.versions.outputs import output_maps, shown
from sysid.versions.policy import ROWS

#: Maps of an output that the page shows.
MAPS_SHOWN = 2
#: A region with fewer rows says nothing about how often intervals hold in it.
REGION_ROWS = 20
#: What `sysid models export` writes: networks without a memory.
EXPORTED = ("actuator", "motion", "forward")
WHAT = {
    "actuator": "Actuator networks: cylinder displacement to joint angle and back, one perceptron a direction and axis.",
    "history": "Actuator networks with history: cylinder displacement to joint angle and back along a motion; a static "
    "perceptron and a memory a direction and axis.",
    "motion": "Command to motion: the history of command and speed, and the position, to the next speed of an axis.",
    "forward": "Forward model: joint values to the position of the end effector in the machine's base frame.",
    "plant": "Plant: the simulation of a machine, commands to motion, with named effects.",
    "policy": "Policy: joints, end effector and target to joint setpoints, trained on a plant.",
}
#: How its layers bend.
CORNERS = {"relu": "", "smooth": ", with smooth rectifiers"}
#: What enters a forward network.
FEATURES = {
    "joints": "joint values",
    "sincos": "sines and cosines of the angles",
    "products": "products of sines and cosines of the angles",
}


@dataclass(frozen=True)
class Block:
    """One heading of a card: paragraphs, a table, code, maps of errors (output, unit, map); any of them may be empty."""

    title: str
    text: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    code: str = ""
    maps: tuple[tuple[str, str, ErrorMap], ...] = ()


@dataclass(frozen=True)
class Card:
    """A card; ``facts`` is the line under its title."""

    title: str
    facts: str
    blocks: tuple[Block, ...]

    def markdown(self) -> str:
        """The card as Markdown."""
        parts = [f"# {self.title}", self.facts]
        for block in self.blocks:
            parts += [f"## {block.title}", *block.text]
            if block.rows:
                lines = [block.header, tuple("---" for _ in block.header), *block.rows]
                parts.append("\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines))
            if block.code:
                parts.append(f"```python\n{block.code}\n```")
        return "\n\n".join(parts) + "\n"


def card_of(
    version: ModelVersion,
    lineage: ModelLineage,
    model: Model | None = None,
    report: ValidationReport | None = None,
    policy: PolicyNetwork | None = None,
) -> Card:
    """The card of a version.

    Args:
        model: the network in it; None for plants and policies.
        report: of it on the held-out rows of the dataset that it was fitted on; None where that cannot be had.
        policy: the policy in it, if it is one.
    """
    aliases = f" ({', '.join(version.aliases)})" if version.aliases else ""
    made = f"{datetime.fromtimestamp(version.created_ms / 1e3, UTC):%Y-%m-%d %H:%M} UTC"
    blocks = [Block("What it is", tuple(_what_policy(version, policy) if policy is not None else _what(version, model)))]
    if report is not None:
        blocks += [_figures(report), *_baselines(report), *_where(report), *_trust(report)]
    elif version.metrics:
        rows = tuple((name, f"{value:.4g}") for name, value in version.metrics.items())
        again = "the actor alone, from random poses to random targets (reach), then staying there (hold)"
        text = (f"As they were stored with it, in SI units; {again if policy else 'its dataset cannot be asked again'}.",)
        blocks.append(Block("Figures", text, ("figure", "value"), rows))
    if version.kind == "plant":
        blocks += _effects(version.lineage)
    if model is not None:
        blocks.append(_ranges(model))
    if policy is not None:
        blocks.append(_policy_ranges(policy))
    blocks.append(Block("Limits", tuple(_policy_limits(policy) if policy is not None else _limits(model, report))))
    blocks.append(_lineage(lineage))
    if version.decisions:
        blocks.append(
            Block("Decisions", (), ("when", "decision", "by", "reason"), tuple(map(decision_row, version.decisions[::-1])))
        )
    blocks.append(Block("Files", (), ("file", "sha256"), tuple(sorted(version.sha256.items()))))
    blocks.append(Block("How to load it", tuple(_loading(version)), code=_code(version)))
    return Card(version.reference, f"{version.kind}{aliases}, made {made}, content {version.digest[:12]}", tuple(blocks))


def decision_row(decision: Decision) -> tuple[str, str, str, str]:
    """When, what, by whom, and why, in words."""
    when = f"{datetime.fromtimestamp(decision.decided_ms / 1e3, UTC):%Y-%m-%d %H:%M}"
    instead = f" instead of {decision.instead_of}" if decision.promoted and decision.instead_of else ""
    what = f"promoted{instead}" if decision.promoted else f"not promoted, {decision.instead_of or 'nothing'} stays"
    judge = str(decision.judged.get("policy") or decision.judged.get("by") or "–")
    judge = f"policy {judge}" if decision.judged.get("by") == "policy" else judge
    if decision.word:
        overruled = f" (overruled: {decision.reason})" if decision.reason else ""
        return when, what, "explicit word", f"{decision.word}{overruled}"
    passed = sum(check.status == "passed" for check in decision.checks)
    told = f"all {passed} conditions hold" if passed else "; ".join(check.text for check in decision.checks)
    return when, what, judge, decision.reason or str(decision.judged.get("as", "")) or told


def _what(version: ModelVersion, model: Model | None) -> Iterator[str]:
    yield WHAT.get(version.kind, version.kind)
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
            quiet = [way for way, memory in zip(("joint", "cylinder"), memories, strict=True) if memory.silent]
            said = f"; silent towards {' and '.join(quiet)}, where it did not help" if quiet else ""
            yield f"{axis}: a memory of {memories[0].units} units that looks every {memories[0].interval:g} s{said}."
        sizes = (f"{axis} {'-'.join(map(str, network.to_joint.hidden))}" for axis, network in static_networks(model).items())
        yield f"Hidden layers: {', '.join(sizes)}."


def _what_policy(version: ModelVersion, policy: PolicyNetwork) -> Iterator[str]:
    yield WHAT["policy"]
    size = "-".join(map(str, policy.mlp.hidden))
    yield f"It is a perceptron ({size}) whose tanh is stretched over the limits of the setpoints."
    recipe = version.lineage.get("recipe", {})
    exploration, learning = recipe.get("exploration", {}), recipe.get("learning", {})
    candidates = exploration.get("candidates", 1)
    how = f"the best of {candidates} candidates by the forward model" if candidates > 1 else "one noisy action a step"
    yield (
        f"DDPG, {learning.get('episodes')} episodes, γ {learning.get('discount')}, batch {learning.get('batch')}, "
        f"explored with {how}; seed {recipe.get('seed')}."
    )


def _policy_ranges(policy: PolicyNetwork) -> Block:
    middle, half = policy.mlp.inputs.mean, policy.mlp.inputs.scale
    rows = [
        ("seen", name, f"{low:.4g}", f"{high:.4g}")
        for name, low, high in zip(policy.inputs, middle - half, middle + half, strict=True)
    ]
    rows += [
        ("setpoint", name, f"{low:.4g}", f"{high:.4g}")
        for name, low, high in zip(policy.outputs, policy.low, policy.high, strict=True)
    ]
    return Block("Ranges", ("In rad, m and their rates.",), ("", "signal", "from", "to"), tuple(rows))


def _policy_limits(policy: PolicyNetwork) -> Iterator[str]:
    yield "Setpoints stay within their limits whatever is observed; whether they are good beyond the ranges seen is not known."
    if not policy.full:
        yield "It was trained where joints follow at once and nothing sways: delay, lag and sway of the machine come on top."
    yield "Bounded least-squares inverse kinematics on the calibrated geometry is the baseline: `sysid track` shows both."


def _figures(report: ValidationReport) -> Block:
    rows = []
    for entry in report.outputs:
        unit, metrics = entry.unit, entry.metrics
        best = _best(entry)
        rows.append(
            (
                f"{entry.output} {ROWS[entry.rows]}",
                shown(metrics.rmse, unit),
                shown(metrics.p95, unit),
                shown(metrics.max, unit),
                "–" if entry.noise_floor is None else shown(entry.noise_floor, unit),
                "–" if best is None else f"{best}: {shown(entry.baselines[best].rmse, unit)}",
            )
        )
    recordings = dict.fromkeys(name for entry in report.outputs for name in entry.recordings)
    text = f"On rows of {report.dataset} that it has not seen ({', '.join(recordings)})."
    return Block("Figures", (text,), ("output", "RMSE", "95 %", "max", "sensor noise alone", "best simple model"), tuple(rows))


def _baselines(report: ValidationReport) -> Iterator[Block]:
    """The RMSE of every simple model, fitted on the same rows, beside its own."""
    names = list(dict.fromkeys(name for entry in report.outputs for name in entry.baselines))
    if not names:
        return
    rows = tuple(
        (
            f"{entry.output} {ROWS[entry.rows]}",
            shown(entry.metrics.rmse, entry.unit),
            *(shown(entry.baselines[name].rmse, entry.unit) if name in entry.baselines else "–" for name in names),
        )
        for entry in report.outputs
    )
    yield Block("Beside simple models", ("RMSE; all learned from the same rows.",), ("output", "this version", *names), rows)


def _where(report: ValidationReport) -> Iterator[Block]:
    """The worst bin of the most telling map of each output; the maps themselves on the page."""
    rows, maps = [], []
    for entry in report.outputs:
        for item in entry.maps[:MAPS_SHOWN]:
            maps.append((f"{entry.output} {ROWS[entry.rows]}", entry.unit, item))
        if entry.maps:
            first = entry.maps[0]
            a, b = first.worst
            ends = (
                f"{name} {edges[k]:.3g} … {edges[k + 1]:.3g} {unit}"
                for name, unit, edges, k in zip(first.over, first.units, first.edges, (a, b), strict=True)
            )
            size, count = shown(first.rmse[a][b], entry.unit), str(first.count[a][b])
            rows.append((f"{entry.output} {ROWS[entry.rows]}", ", ".join(ends), size, count, f"{100.0 * first.explains:.0f} %"))
    if rows:
        header = ("output", "largest where", "RMSE there", "rows", "explained by place")
        yield Block("Where its errors are", (), header, tuple(rows), maps=tuple(maps))


def _trust(report: ValidationReport) -> Iterator[Block]:
    """Whether its intervals hold, and what it flags as outside its data."""
    rows = []
    for entry in report.outputs:
        if entry.coverage is None:
            continue
        found = entry.coverage
        crowded = [region for region in found.regions if region.count >= REGION_ROWS]
        worst = min(crowded, key=lambda region: region.covered, default=None)
        rows.append(
            (
                f"{entry.output} {ROWS[entry.rows]}",
                f"± {shown(found.half_width, entry.unit)}",
                f"{100.0 * found.covered:.1f} %",
                "–" if worst is None else f"{worst.name}: {100.0 * worst.covered:.0f} %",
                f"{100.0 * found.flagged:.1f} %",
            )
        )
    if rows:
        level = next(entry.coverage.level for entry in report.outputs if entry.coverage is not None)
        text = (
            f"Its {100.0 * level:g} % intervals (`predict_interval`) on rows that it has not seen, and the rows that it flags "
            f"as outside its data (`inside`; of rows like those that it learned from {100.0 * FALSE_FLAGS:g} %)."
        )
        header = ("output", "half width, median", "hold in", "least often in", "flagged")
        yield Block("How sure it is", (text,), header, tuple(rows))


def _ranges(model: Model) -> Block:
    found: dict[str, tuple[str, ...]] = {}
    for answer in output_maps(model):
        for signal, unit, low, high in zip(answer.inputs, answer.units, answer.low, answer.high, strict=True):
            found[signal] = (signal, f"{low:.4g}", f"{high:.4g}", unit)
    return Block("Ranges that it was fitted on", (), ("input", "from", "to", "unit"), tuple(found.values()))


def _limits(model: Model | None, report: ValidationReport | None) -> Iterator[str]:
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
            if (best := _best(entry)) is not None and entry.baselines[best].rmse < entry.metrics.rmse
        ]
        if worse:
            yield f"A simple model is as good or better in: {', '.join(worse)}."
        spikes = sorted(((e, s) for e in report.outputs for s in e.spikes), key=lambda pair: -pair[1].sigmas)
        for entry, spike in spikes[:3]:
            where = f"{spike.time:.2f} s of {spike.recording} ({spike.cause.replace('_', ' ')})"
            yield f"Among its largest errors: {entry.output} {shown(spike.error, entry.unit)} at {where}."
    yield "It was judged on the machine as it was then: `sysid validate` with newer recordings says whether it still fits."


def _lineage(found: ModelLineage) -> Block:
    rows: list[tuple[str, ...]] = []
    if found.dataset:
        rows.append(("made from", found.dataset, "dataset", found.dataset_digest[:12]))
    if found.source is not None:
        files = [source for part in found.source.parts for source in part.sources]
        rows += [("raw file", source.path, f"{source.size} bytes", source.sha256[:12]) for source in files]
    rows += [("made from", item.reference, item.kind, item.digest[:12]) for item in found.parents]
    rows += [("used by", item.reference, item.kind, item.digest[:12]) for item in found.children]
    rows += [("used by", use.what, use.how, f"on {use.dataset}") for use in found.uses]
    return Block("Lineage", (found.missing,) if found.missing else (), ("", "what", "kind", "content"), tuple(rows))


def _effects(lineage: Mapping[str, Any]) -> list[Block]:
    rows = []
    for effect in lineage.get("effects", ()):
        numbers = ", ".join(
            f"{key} {value:.4g}" for key, value in effect.get("parameters", {}).items() if isinstance(value, float)
        )
        rows.append(
            (str(effect.get("name")), str(effect.get("target")), numbers, f"{100.0 * effect.get('closed_share', 0.0):.0f} %")
        )
    if not rows:
        return []
    return [
        Block(
            "Effects that were found missing", (), ("effect", "on", "parameters [SI]", "share of the gap closed"), tuple(rows)
        )
    ]


def _loading(version: ModelVersion) -> Iterator[str]:
    yield f"`name@version` never changes; `{version.name}` alone means the champion, or the newest where none was promoted."
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


def _best(entry: OutputReport) -> str | None:
    return min(entry.baselines, key=lambda name: entry.baselines[name].rmse, default=None)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
