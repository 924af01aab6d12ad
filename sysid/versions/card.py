"""The card of a model version: purpose, errors beside simple models, ranges, limits, provenance, loading.

The blocks are defined in ``card_block``; those of networks and policies are made in ``card_network``, those of error reports in
``card_report``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from sysid.display import percent
from sysid.effects import BY_NAME
from sysid.effects.wording import title_of
from sysid.networks import Model
from sysid.networks.policy import PolicyNetwork
from sysid.registry import NETWORKS, ModelVersion
from sysid.registry.decision import decision_row
from sysid.registry.effect_changes import effect_value
from sysid.validate import ValidationReport
from sysid.versions.card_block import Card, CardBlock
from sysid.versions.card_network import (
    network_limits,
    network_ranges,
    policy_limits,
    policy_ranges,
    what_network,
    what_policy,
)
from sysid.versions.card_report import baselines, error_maps, figures, uncertainty
from sysid.versions.lineage import ModelLineage

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
) -> Card:
    """The card of a version.

    Args:
        model: the network in it; None for plants and policies.
        report: its evaluation on the held-out rows of its own dataset; None if that is not available.
        policy: the policy in it; None for other kinds.
    """
    aliases = f" ({', '.join(version.aliases)})" if version.aliases else ""
    made = f"{datetime.fromtimestamp(version.created_ms / 1e3, UTC):%Y-%m-%d %H:%M} UTC"
    details = what_policy(version, policy) if policy is not None else what_network(model)
    blocks = [CardBlock("What it is", (DESCRIPTIONS.get(version.kind, version.kind), *details))]
    if report is not None:
        blocks += [figures(report), *baselines(report), *error_maps(report), *uncertainty(report)]
    elif version.metrics:
        rows = tuple((name, f"{value:.4g}") for name, value in version.metrics.items())
        what = "the actor alone, from random poses to random targets (reach), then staying there (hold)"
        text = (f"As stored with it, in SI units; {what if policy else 'its dataset is not available'}.",)
        blocks.append(CardBlock("Figures", text, ("figure", "value"), rows))
    if version.kind == "plant":
        blocks += _effects(version.lineage)
    if model is not None:
        blocks.append(network_ranges(model))
    if policy is not None:
        blocks.append(policy_ranges(policy))
    blocks.append(CardBlock("Limits", tuple(policy_limits(policy) if policy is not None else network_limits(model, report))))
    blocks.append(_lineage(lineage))
    if version.decisions:
        blocks.append(
            CardBlock("Decisions", (), ("when", "decision", "by", "reason"), tuple(map(decision_row, version.decisions[::-1])))
        )
    blocks.append(CardBlock("Files", (), ("file", "sha256"), tuple(sorted(version.sha256.items()))))
    blocks.append(CardBlock("How to load it", tuple(_loading(version)), code=_code(version)))
    return Card(version.reference, f"{version.kind}{aliases}, made {made}, content {version.digest[:12]}", tuple(blocks))


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
    return CardBlock("Lineage", (found.missing,) if found.missing else (), ("", "what", "kind", "content"), tuple(rows))


def _effects(lineage: Mapping[str, Any]) -> list[CardBlock]:
    rows = []
    for effect in lineage.get("effects", ()):
        name, target, units = str(effect.get("name")), str(effect.get("target")), effect.get("units", {})
        parameters = effect.get("parameters", {}).items()
        values = ", ".join(f"{key.replace('_', ' ')} {effect_value(value, units.get(key, ''))}" for key, value in parameters)
        title = title_of(BY_NAME[name], target, None) if name in BY_NAME else name
        rows.append((title, target, values, percent(effect.get("closed_share", math.nan))))
    if not rows:
        return []
    return [CardBlock("Added effects", (), ("effect", "on", "parameters", "share of the gap closed"), tuple(rows))]


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
