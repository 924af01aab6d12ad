"""The next experiment: which recording would answer what the recordings so far leave open, as a file that can be executed."""

from sysid.gap.experiment.experiment import EffectAt, Experiment, Purpose, outside
from sysid.gap.experiment.file import read_experiment, write_experiment
from sysid.gap.experiment.open_hypothesis import Question, questions_of
from sysid.gap.experiment.proposal import Planning, Proposal, propose, rehearse

__all__ = [
    "EffectAt",
    "Experiment",
    "Planning",
    "Proposal",
    "Purpose",
    "Question",
    "outside",
    "propose",
    "questions_of",
    "read_experiment",
    "rehearse",
    "write_experiment",
]
