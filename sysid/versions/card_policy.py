"""Blocks of a policy's card: training, ranges of observations and setpoints, limits."""

from __future__ import annotations

from collections.abc import Iterator

from sysid.networks.policy import PolicyNetwork
from sysid.registry import ModelVersion
from sysid.versions.card_block import CardBlock


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
