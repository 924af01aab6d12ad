"""What a card says of a policy: how it was trained, what it has seen, where it may be trusted."""

from __future__ import annotations

from collections.abc import Iterator

from sysid.networks.policy import PolicyNetwork
from sysid.registry import ModelVersion
from sysid.versions.card_block import CardBlock


def what_policy(version: ModelVersion, policy: PolicyNetwork) -> Iterator[str]:
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


def policy_ranges(policy: PolicyNetwork) -> CardBlock:
    middle, half = policy.mlp.inputs.mean, policy.mlp.inputs.scale
    rows = [
        ("seen", name, f"{low:.4g}", f"{high:.4g}")
        for name, low, high in zip(policy.inputs, middle - half, middle + half, strict=True)
    ]
    rows += [
        ("setpoint", name, f"{low:.4g}", f"{high:.4g}")
        for name, low, high in zip(policy.outputs, policy.low, policy.high, strict=True)
    ]
    return CardBlock("Ranges", ("In rad, m and their rates.",), ("", "signal", "from", "to"), tuple(rows))


def policy_limits(policy: PolicyNetwork) -> Iterator[str]:
    yield "Setpoints stay within their limits whatever is observed; whether they are good beyond the ranges seen is not known."
    if not policy.full:
        yield "It was trained where joints follow at once and nothing sways: delay, lag and sway of the machine come on top."
    yield "Bounded least-squares inverse kinematics on the calibrated geometry is the baseline: `sysid track` shows both."
