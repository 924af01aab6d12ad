"""The plant: the chain of effects in physical order, compiled; free and stage-wise runs."""

from sysid.plant.model import Model, compile_plant
from sysid.plant.plant import Plant, effects_toml, nominal_plant, plant_from_files
from sysid.plant.rollout import free_run

__all__ = ["Model", "Plant", "compile_plant", "effects_toml", "free_run", "nominal_plant", "plant_from_files"]
