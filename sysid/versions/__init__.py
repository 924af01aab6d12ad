"""Operations on model versions: promotion by a policy, drift, differences, lineage, ONNX."""

from sysid.versions.diff import ModelDiff, diff_versions
from sysid.versions.drift import DriftReport, OutputDrift, drift_of
from sysid.versions.lineage import ModelLineage, lineage_of
from sysid.versions.onnx_export import ExportedFile, export_onnx
from sysid.versions.outputs import OutputMap, output_maps
from sysid.versions.policy import PromotionPolicy, load_policy, policy_checks

__all__ = [
    "DriftReport",
    "ExportedFile",
    "ModelDiff",
    "ModelLineage",
    "OutputDrift",
    "OutputMap",
    "PromotionPolicy",
    "diff_versions",
    "drift_of",
    "export_onnx",
    "lineage_of",
    "load_policy",
    "output_maps",
    "policy_checks",
]
