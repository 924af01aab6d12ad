"""A crane of four axes whose linkages are known, and a forward model of it that is never wrong: what policies are tried on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.plant import Plant, compile_plant, nominal_plant
from sysid.signals import axis_signal
from sysid_rl.train.reach import joint_limits, tips

Array = npt.NDArray[np.float64]
AUTOLOG = Path(__file__).parents[2] / "datasets" / "autolog"
LINKAGES = {
    "stroke = [0.0, 0.1010]": 'linkage = {kind = "triangle", a = 0.06, b = 0.18, offset = 0.93, retracted = 0.138}',
    "stroke = [0.0, 0.1349]": 'linkage = {kind = "triangle", a = 0.06, b = 0.24, offset = 2.87, retracted = 0.183}',
}


def crane() -> Machine:
    """The demo's crane with triangles for the linkages, which its own description leaves to be fitted."""
    text = (AUTOLOG / "machine.toml").read_text("utf-8")
    for stroke, linkage in LINKAGES.items():
        assert stroke in text
        text = text.replace(stroke, f"{stroke}\n{linkage}")
    return machine_from_files({"machine.toml": text, "autolog.urdf": (AUTOLOG / "autolog.urdf").read_text("utf-8")}, "crane")


def crane_plant(*effects: KnownEffect) -> Plant:
    """Its plant, with further effects."""
    plant = nominal_plant(crane())
    for effect in effects:
        plant = plant.with_effect(effect)
    return plant


@dataclass(frozen=True)
class Perfect:
    """A forward model that is the plant itself."""

    plant: Plant

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(axis_signal(name, "joint") for name in self.plant.machine.axis_names)

    @property
    def low(self) -> Array:
        return joint_limits(self.plant)[0]

    @property
    def high(self) -> Array:
        return joint_limits(self.plant)[1]

    def predict(self, q: npt.ArrayLike) -> Array:
        return tips(compile_plant(self.plant), np.atleast_2d(np.asarray(q, dtype=np.float64)))

    def spread(self, q: npt.ArrayLike) -> Array:
        return np.zeros((len(np.atleast_2d(np.asarray(q, dtype=np.float64))), 3))
