"""The plant: the chain of effects in physical order, compiled; free and stage-wise runs."""

from sysid.plant.gravity import gravity_load
from sysid.plant.machine_text import machine_difference, machine_text
from sysid.plant.model import Model, compile_plant
from sysid.plant.plant import Plant, effects_toml, nominal_plant, plant_from_files
from sysid.plant.rollout import free_run
from sysid.plant.uncertainty import PlantNumber, Uncertainty

__all__ = [
    "Model",
    "Plant",
    "PlantNumber",
    "Uncertainty",
    "compile_plant",
    "effects_toml",
    "free_run",
    "gravity_load",
    "machine_difference",
    "machine_text",
    "nominal_plant",
    "plant_from_files",
]
