"""Experiment design: recordings that would resolve the open hypotheses of a dataset, as files that can be executed."""

from sysid.gap.experiment.experiment import EffectAt, Experiment, Purpose, outside, read_experiment, write_experiment
from sysid.gap.experiment.open_hypothesis import OpenHypothesis, open_hypotheses
from sysid.gap.experiment.proposal import ExperimentProposal, Planning, dry_run, propose

__all__ = [
    "EffectAt",
    "Experiment",
    "ExperimentProposal",
    "OpenHypothesis",
    "Planning",
    "Purpose",
    "dry_run",
    "open_hypotheses",
    "outside",
    "propose",
    "read_experiment",
    "write_experiment",
]
