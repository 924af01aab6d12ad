"""The gap workflow: where simulation and machine disagree, what the missing effect is called, and the proof."""

from sysid.gap.result import GapResult
from sysid.gap.search import Strictness
from sysid.gap.workflow import find_gap

__all__ = ["GapResult", "Strictness", "find_gap"]
