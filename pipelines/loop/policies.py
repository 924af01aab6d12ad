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

#: Where joints follow at once: a map from target to joints. Twice its episodes: three minutes of a core.
TIMES = 2
RECIPE = Path(__file__).resolve().parents[2] / "rl" / "autolog" / "quick.toml"
#: A policy of a redundant machine begins in another posture than inverse kinematics, and approaches it at limited speed.
CHECKS = {"policy": {"share": 1.0}}


def policy_deployment(site: Site, plant: Plant, below: Deployment) -> Deployment:
    """Train a policy where the joints of a registered plant follow at once, and deploy it with the versions of ``below``.

    The targets are shown to it one response time of the plant ahead, as ``ik-lookahead`` has them.
    """
    recipe = load_training(RECIPE)
    learning = replace(recipe.learning, episodes=TIMES * recipe.learning.episodes)
    recipe = replace(recipe, name="loop-policy", plant=below.plant, forward=below.forward, learning=learning)
    trained = train_policy(site.workspace.models, recipe, site.folder / "training")
    checks = {**below.checks, **CHECKS}
    return replace(below, policy=trained.version.reference, checks=checks, lookahead=lookahead_time(plant))
