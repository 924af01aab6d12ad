"""Policies in the loop: one is trained for a plant and its kinematics, and deployed with the controller of that plant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from loop.deployment import Deployment
from loop.rounds import Site
from sysid.plant import Plant
from sysid_rl.control import lookahead_time
from sysid_rl.train.recipe import load_training
from sysid_rl.train.training import train_policy

#: Where joints follow at once: a map from target to joints.
RECIPE = Path(__file__).resolve().parents[2] / "rl" / "autolog" / "quick.toml"


def policy_deployment(site: Site, plant: Plant, below: Deployment) -> Deployment:
    """Train a policy where the joints of a registered plant follow at once, and deploy it with the versions of ``below``.

    The targets are shown to it one response time of the plant ahead, as ``ik-lookahead`` has them.
    """
    recipe = replace(load_training(RECIPE), name="loop-policy", plant=below.plant, forward=below.forward)
    trained = train_policy(site.workspace.models, recipe, site.folder / "training")
    return replace(below, policy=trained.version.reference, lookahead=lookahead_time(plant))
