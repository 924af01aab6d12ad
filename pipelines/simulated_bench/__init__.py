"""The simulated test bench: a simulation of the crane with real wire formats, for demonstrations and tests with known truth.

It is independent of the library that identifies machines: it shares no code with ``sysid.effects``, ``sysid.plant`` or
``sysid.gap``, and none of them imports it. Reading order: ``recipe``, then the physical parts in the order of the signal
(``operator``, ``programs`` or ``poses``, ``valve``, ``cylinder``, ``drivetrain``, ``crane``, ``gripper``,
joined in ``machine``), then what sees them (``sensors``, ``capture``), then the files (``mcap_log``, ``motive_export``,
``truth``, ``write``).

An axis may be hydraulic instead of a simple valve: ``circuit`` joins ``spool``, ``oil``, ``seal`` and ``rigid_body``. Machines
that are moved joint by joint, a servo arm and a slide, start in ``joint_machines``. ``case`` seals a machine that hides
something: ``nominal`` fits what its owner would know, with the formulas of ``contract_chain``.

``python -m simulated_bench RECIPE.toml OUT`` writes all recordings of a recipe,
``python -m simulated_bench case CASE.toml OUT`` a sealed case.
"""

from simulated_bench.recipe import AXES, BenchRecipe, RecordingSettings
from simulated_bench.recipe_file import load_recipe
from simulated_bench.run import MachineLog, Run, simulate
from simulated_bench.truth import describe_effects, without_hidden
from simulated_bench.write import write, write_all

__all__ = [
    "AXES",
    "BenchRecipe",
    "MachineLog",
    "RecordingSettings",
    "Run",
    "describe_effects",
    "load_recipe",
    "simulate",
    "without_hidden",
    "write",
    "write_all",
]
