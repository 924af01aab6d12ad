"""Versions of networks, plants and policies with their lineage, in an MLflow model registry (loaded late)."""

from sysid.registry.registry import Registry
from sysid.registry.version import KINDS, PROMOTED, Kind, ModelVersion

__all__ = ["KINDS", "PROMOTED", "Kind", "ModelVersion", "Registry"]
