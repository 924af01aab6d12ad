"""``json``: the whole plant as data, with the drive model that computes it."""

from __future__ import annotations

import json
from pathlib import Path

from sysid.effects import Effect, effect_named
from sysid.export.drive_data import WITHOUT_PART
from sysid.export.drive_module import MODULE, DriveModelSimulation, load_module, write_drive_model
from sysid.export.names import MachineNames, axis_names
from sysid.export.target import Simulation, Support
from sysid.plant import Plant

#: File with the effects and their units.
FILE = "plant.json"


class JsonTarget:
    """Effects with parameters, units and equations, beside the drive model."""

    name = "json"
    title = "JSON and a Python module"
    modules: tuple[str, ...] = ()
    resolution, arms = 0.0, False
    notes: tuple[str, ...] = ()

    def names(self, plant: Plant) -> MachineNames:
        return axis_names(plant.machine.name, plant.machine.axis_names)

    def support(self, effect: Effect) -> Support:
        if effect.name in WITHOUT_PART:
            return Support("native", f"`{FILE}` alone ({WITHOUT_PART[effect.name]})")
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
        return DriveModelSimulation(plant, load_module(folder / MODULE).load())
