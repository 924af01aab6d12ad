"""Actuator networks (cylinder ↔ joint) and the forward network (joints → end effector). Torch is loaded by fitting alone."""

from sysid.networks.actuator import ActuatorNetwork, RoundTrip, fit_actuator
from sysid.networks.artifacts import Model, from_files, to_files
from sysid.networks.calibration import Calibrated, Calibration, calibrate
from sysid.networks.chain import Chain, fit_chain
from sysid.networks.checkpoint import Checkpoints
from sysid.networks.forward import ForwardModel, ForwardNetwork, learn_forward
from sysid.networks.forward_models import AnyForward, fit_forward
from sysid.networks.geometry import Geometry, GeometryParameter
from sysid.networks.member import Course, Member, Trained, TrainingSettings
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.recipe import PAPER_MAX, ActuatorRecipe, ForwardRecipe, NetworkRecipe, load_recipe, parse_recipe
from sysid.networks.structured import StructuredForward, fit_structured
from sysid.networks.training import train
from sysid.networks.trust import Domain, Intervals, Trust

__all__ = [
    "PAPER_MAX",
    "ActuatorNetwork",
    "ActuatorRecipe",
    "AnyForward",
    "Calibrated",
    "Calibration",
    "Chain",
    "Checkpoints",
    "Course",
    "Domain",
    "ForwardModel",
    "ForwardNetwork",
    "ForwardRecipe",
    "Geometry",
    "GeometryParameter",
    "Intervals",
    "Member",
    "Mlp",
    "Model",
    "NetworkRecipe",
    "Normalisation",
    "RoundTrip",
    "StructuredForward",
    "Trained",
    "TrainingSettings",
    "Trust",
    "calibrate",
    "fit_actuator",
    "fit_chain",
    "fit_forward",
    "fit_structured",
    "from_files",
    "learn_forward",
    "load_recipe",
    "parse_recipe",
    "to_files",
    "train",
]
