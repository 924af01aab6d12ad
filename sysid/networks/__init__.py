"""Actuator networks (cylinder ↔ joint) and the forward network (joints → end effector). Torch is loaded by fitting alone."""

from sysid.networks.actuator import ActuatorNetwork, RoundTrip, fit_actuator
from sysid.networks.artifacts import Model, from_files, to_files
from sysid.networks.forward import ForwardNetwork, fit_forward
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.recipe import PAPER_MAX, ActuatorRecipe, ForwardRecipe, NetworkRecipe, load_recipe, parse_recipe
from sysid.networks.training import Course, Member, Trained, TrainingSettings, train

__all__ = [
    "PAPER_MAX",
    "ActuatorNetwork",
    "ActuatorRecipe",
    "Course",
    "ForwardNetwork",
    "ForwardRecipe",
    "Member",
    "Mlp",
    "Model",
    "NetworkRecipe",
    "Normalisation",
    "RoundTrip",
    "Trained",
    "TrainingSettings",
    "fit_actuator",
    "fit_forward",
    "from_files",
    "load_recipe",
    "parse_recipe",
    "to_files",
    "train",
]
