"""The stand-in machine: a simulation of the crane with real wire formats, for demonstrations and for tests with a known truth.

It is independent of the library that identifies machines: it shares no code with ``sysid.effects``, ``sysid.plant`` or
``sysid.gap``, and none of them imports it. Reading order: ``recipe``, then the physical parts in the order of the signal
(``operator`` or ``poses``, ``valve``, ``cylinder``, ``drivetrain``, ``crane``, ``gripper``, joined in ``machine``), then what
sees them (``sensors``, ``capture``), then the files (``mcap_log``, ``motive_export``, ``truth``, ``write``).

``python -m sysid.bench RECIPE.toml OUT`` writes all recordings of a recipe.
"""

from sysid.bench.recipe import AXES, Recipe, RecordingSettings
from sysid.bench.recipe_file import load_recipe
from sysid.bench.run import MachineLog, Run, simulate
from sysid.bench.truth import describe_effects, without_hidden
from sysid.bench.write import write, write_all

__all__ = [
    "AXES",
    "MachineLog",
    "Recipe",
    "RecordingSettings",
    "Run",
    "describe_effects",
    "load_recipe",
    "simulate",
    "without_hidden",
    "write",
    "write_all",
]
