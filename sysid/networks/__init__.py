"""Networks: actuator (cylinder ↔ joint), command → motion, forward (joints → end effector). Fitting alone loads torch."""

from sysid.networks.actuator import ActuatorNetwork, RoundTripError, fit_actuator
from sysid.networks.artifacts import Model, from_files, history_networks, motion_networks, static_networks, to_files
from sysid.networks.calibration import CalibratedParameter, Calibration, calibrate
from sysid.networks.chain import FittedChain, fit_chain
from sysid.networks.checkpoint import Checkpoints
from sysid.networks.forward import ForwardModel, ForwardNetwork, learn_forward
from sysid.networks.geometry import Geometry, GeometryParameter
from sysid.networks.history import HistoryNetwork, fit_history
from sysid.networks.member import EnsembleMember, LearningCurve, TrainedMember, TrainingSettings
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.motion import MotionNetwork, fit_motion
from sysid.networks.recipe import (
    PAPER_MAX,
    ActuatorRecipe,
    ForwardRecipe,
    HistoryRecipe,
    MotionRecipe,
    NetworkRecipe,
    load_recipe,
    parse_recipe,
)
from sysid.networks.structured import StructuredForward, fit_forward, fit_structured
from sysid.networks.training import train
from sysid.networks.uncertainty import Intervals, NetworkUncertainty, TrainingDomain

__all__ = [
    "PAPER_MAX",
    "ActuatorNetwork",
    "ActuatorRecipe",
    "CalibratedParameter",
    "Calibration",
    "Checkpoints",
    "EnsembleMember",
    "FittedChain",
    "ForwardModel",
    "ForwardNetwork",
    "ForwardRecipe",
    "Geometry",
    "GeometryParameter",
    "HistoryNetwork",
    "HistoryRecipe",
    "Intervals",
    "LearningCurve",
    "Mlp",
    "Model",
    "MotionNetwork",
    "MotionRecipe",
    "NetworkRecipe",
    "NetworkUncertainty",
    "Normalisation",
    "RoundTripError",
    "StructuredForward",
    "TrainedMember",
    "TrainingDomain",
    "TrainingSettings",
    "calibrate",
    "fit_actuator",
    "fit_chain",
    "fit_forward",
    "fit_history",
    "fit_motion",
    "fit_structured",
    "from_files",
    "history_networks",
    "learn_forward",
    "load_recipe",
    "motion_networks",
    "parse_recipe",
    "static_networks",
    "to_files",
    "train",
]
