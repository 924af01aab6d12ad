"""Networks: actuator (cylinder ↔ joint), command → motion, forward (joints → end effector). Fitting alone loads torch.

A name is imported when it is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid.lazy import lazy_names

if TYPE_CHECKING:
    from sysid.networks.actuator import ActuatorNetwork, fit_actuator
    from sysid.networks.artifacts import Model, from_files, history_networks, motion_networks, static_networks, to_files
    from sysid.networks.calibration import Calibration, calibrate
    from sysid.networks.chain import FittedChain, fit_chain
    from sysid.networks.forward import ForwardModel, ForwardNetwork, fit_forward_network
    from sysid.networks.geometry import Geometry
    from sysid.networks.history import HistoryNetwork, fit_history
    from sysid.networks.member import Checkpoints, EnsembleMember, TrainedMember, TrainingSettings
    from sysid.networks.mlp import Mlp, Normalisation
    from sysid.networks.motion import MotionNetwork, fit_motion
    from sysid.networks.recipe import (
        PAPER_MAX,
        ForwardRecipe,
        NetworkRecipe,
        load_recipe,
        parse_recipe,
    )
    from sysid.networks.structured import StructuredForward, fit_forward
    from sysid.networks.training import train
    from sysid.networks.uncertainty import NetworkUncertainty

__all__ = [
    "PAPER_MAX",
    "ActuatorNetwork",
    "Calibration",
    "Checkpoints",
    "EnsembleMember",
    "FittedChain",
    "ForwardModel",
    "ForwardNetwork",
    "ForwardRecipe",
    "Geometry",
    "HistoryNetwork",
    "Mlp",
    "Model",
    "MotionNetwork",
    "NetworkRecipe",
    "NetworkUncertainty",
    "Normalisation",
    "StructuredForward",
    "TrainedMember",
    "TrainingSettings",
    "calibrate",
    "fit_actuator",
    "fit_chain",
    "fit_forward",
    "fit_forward_network",
    "fit_history",
    "fit_motion",
    "from_files",
    "history_networks",
    "load_recipe",
    "motion_networks",
    "parse_recipe",
    "static_networks",
    "to_files",
    "train",
]

__getattr__ = lazy_names(
    __name__,
    {
        "actuator": ["ActuatorNetwork", "fit_actuator"],
        "artifacts": ["Model", "from_files", "history_networks", "motion_networks", "static_networks", "to_files"],
        "calibration": ["Calibration", "calibrate"],
        "chain": ["FittedChain", "fit_chain"],
        "forward": ["ForwardModel", "ForwardNetwork", "fit_forward_network"],
        "geometry": ["Geometry"],
        "history": ["HistoryNetwork", "fit_history"],
        "member": ["Checkpoints", "EnsembleMember", "TrainedMember", "TrainingSettings"],
        "mlp": ["Mlp", "Normalisation"],
        "motion": ["MotionNetwork", "fit_motion"],
        "recipe": ["PAPER_MAX", "ForwardRecipe", "NetworkRecipe", "load_recipe", "parse_recipe"],
        "structured": ["StructuredForward", "fit_forward"],
        "training": ["train"],
        "uncertainty": ["NetworkUncertainty"],
    },
)
