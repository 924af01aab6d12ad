"""The next experiment: which recording would answer what the recordings so far leave open, as a file that can be executed."""

from sysid.gap.experiment.experiment import EffectAt, Experiment, Purpose, outside
from sysid.gap.experiment.file import read_experiment, write_experiment
from sysid.gap.experiment.propose import Planning, Proposal, propose, rehearse
from sysid.gap.experiment.question import Question, questions_of

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
