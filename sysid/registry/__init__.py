"""Versions of networks, plants and policies with their lineage, in an MLflow model registry (loaded late)."""

from sysid.registry.promotion import Check, Promotion, PromotionDecision
from sysid.registry.registry import DamagedModel, Registry, decide
from sysid.registry.repair import RepairReport
from sysid.registry.version import (
    CANDIDATE,
    CHAMPION,
    KINDS,
    NETWORKS,
    Kind,
    ModelVersion,
    ancestors,
    dataset_descendants,
    descendants,
)

__all__ = [
    "CANDIDATE",
    "CHAMPION",
    "KINDS",
    "NETWORKS",
    "Check",
    "DamagedModel",
    "Kind",
    "ModelVersion",
    "Promotion",
    "PromotionDecision",
    "Registry",
    "RepairReport",
    "ancestors",
    "dataset_descendants",
    "decide",
    "descendants",
]
