"""``json``: the whole plant as data, with the drive model that computes it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from sysid.effects import Effect, effect_named
from sysid.export.drive_data import WITHOUT_PART
from sysid.export.drive_module import MODULE, drive_simulation, load_module, write_drive_model
from sysid.export.names import MachineNames, axis_names
from sysid.export.target import Simulation, Support, Target
from sysid.plant import Plant

#: File with the effects and their units.
FILE = "plant.json"


class JsonTarget(Target):
    """Effects with parameters, units and equations, beside the drive model."""

    name = "json"
    title = "JSON and a Python module"
    native: Mapping[str, str] = {effect: f"`{FILE}` alone ({why})" for effect, why in WITHOUT_PART.items()}

    def names(self, plant: Plant) -> MachineNames:
        return axis_names(plant.machine.name, plant.machine.axis_names)

    def otherwise(self, effect: Effect) -> Support:
        return Support("native", f"`{FILE}`, computed by `{MODULE}`")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        content = json.loads(plant.to_files()["plant.json"])
        for item in content["effects"]:
            effect = effect_named(item["name"])
            units = {p.name: p.unit for form in effect.forms for p in form.parameters}
            item |= {
                "title": effect.title,
                "equation": effect.equation,
                "source": effect.source,
                "units": {name: units[name] for name in item["parameters"]},
            }
        (folder / FILE).write_text(json.dumps(content, indent=1, ensure_ascii=False), "utf-8")
        return FILE, *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        return drive_simulation(plant, load_module(folder / MODULE).load())
