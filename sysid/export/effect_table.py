"""``effects.csv``: every number of the effects of a plant, for formats that have no place for them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from sysid.effects.units import parameter_unit
from sysid.plant import Plant

FILE = "effects.csv"


def write_effect_table(plant: Plant, folder: Path) -> str:
    """Write the table; returns its name."""
    with (folder / FILE).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("effect", "target", "side", "parameter", "component", "value", "unit"))
        for item in plant.effects:
            for name, value in item.parameters.items():
                unit = parameter_unit(item.name, name, item.target, plant.machine)
                for k, number in enumerate(np.atleast_1d(np.asarray(value, dtype=np.float64))):
                    writer.writerow((item.name, item.target, item.side or "", name, k, repr(float(number)), unit))
    return FILE
