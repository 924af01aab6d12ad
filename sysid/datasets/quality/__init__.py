"""Quality and excitation of a dataset in numbers."""

from sysid.datasets.quality.describe import describe
from sysid.datasets.quality.evidence import DatasetEvidence, evidence_of
from sysid.datasets.quality.noise import noise_of

__all__ = ["DatasetEvidence", "describe", "evidence_of", "noise_of"]
