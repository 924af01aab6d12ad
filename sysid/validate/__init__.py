"""Error reports of networks on held-out recordings: metrics, baselines, error profiles and maps, spikes, coverage."""

from sysid.validate.error_analysis import ErrorMap
from sysid.validate.metrics import ErrorMetrics, error_metrics
from sysid.validate.report import OutputReport, ValidationReport
from sysid.validate.validation import validate_actuator, validate_forward, validate_history, validate_model, validate_motion

__all__ = [
    "ErrorMap",
    "ErrorMetrics",
    "OutputReport",
    "ValidationReport",
    "error_metrics",
    "validate_actuator",
    "validate_forward",
    "validate_history",
    "validate_model",
    "validate_motion",
]
