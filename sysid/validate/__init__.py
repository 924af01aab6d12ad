"""Error reports of networks on recordings they have not seen: figures, baselines, where the errors are, spikes."""

from sysid.validate.coverage import Coverage, Region
from sysid.validate.error_analysis import Profile, Spike
from sysid.validate.error_maps import ErrorMap
from sysid.validate.folds import folds
from sysid.validate.metrics import ErrorMetrics, error_metrics
from sysid.validate.report import OutputReport, Trace, ValidationReport
from sysid.validate.validation import validate_actuator, validate_forward, validate_model  # first: `along` builds on it

from sysid.validate.free_runs import validate_history, validate_motion  # isort: skip

__all__ = [
    "Coverage",
    "ErrorMap",
    "ErrorMetrics",
    "OutputReport",
    "Profile",
    "Region",
    "Spike",
    "Trace",
    "ValidationReport",
    "error_metrics",
    "folds",
    "validate_actuator",
    "validate_forward",
    "validate_history",
    "validate_model",
    "validate_motion",
]
