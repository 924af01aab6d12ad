"""From a folder of logs to the description of a machine: what the data show is drafted, the rest becomes questions."""

from sysid.datasets.drafting.description import Description, describe
from sysid.datasets.drafting.fields import Question

__all__ = ["Description", "Question", "describe"]
