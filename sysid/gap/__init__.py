"""The gap workflow: errors of a simulation against recordings, the missing effects, and their proof."""

from sysid.gap import steps
from sysid.gap.adapters.adapter import SimulatorAdapter, adapt_simulator
from sysid.gap.adapters.simulator import BatchSimulator, Simulator, starting_value
from sysid.gap.result import GapResult
from sysid.gap.workflow import find_gap

__all__ = [
    "BatchSimulator",
    "GapResult",
    "Simulator",
    "SimulatorAdapter",
    "adapt_simulator",
    "find_gap",
    "starting_value",
    "steps",
]
