"""From a folder of logs to the description of a machine: what the data show is drafted, the rest becomes questions."""

from sysid.start.description import Description, describe
from sysid.start.question import Question

__all__ = ["Description", "Question", "describe"]
