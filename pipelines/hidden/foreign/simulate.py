"""One recording of a machine by the simulator of its family, with the sensors of the machine."""

from __future__ import annotations

import numpy as np
import pandas as pd

from hidden.foreign.excitation import Take
from hidden.foreign.machines import Tables


def simulate(tables: Tables, take: Take) -> pd.DataFrame:
    """``time`` and canonical columns on the controller's grid; biases, scales and steps of sensors are in it, noise is not."""
    if tables["family"].startswith("mujoco"):
        from hidden.foreign.mujoco_run import run_mujoco as run
    else:
        from hidden.foreign.bullet_run import run_bullet as run
    table = run(tables, take)
    return table.assign(**{name: through(tables, name, table[name].to_numpy()) for name in tables["sensors"]})


def through(tables: Tables, signal: str, values: np.ndarray) -> np.ndarray:
    """Readings of a sensor without quantisation, which follows after the noise."""
    sensor = tables["sensors"].get(signal, {})
    return np.asarray(sensor.get("scale", 1.0) * values + sensor.get("bias", 0.0))


def quantised(tables: Tables, table: pd.DataFrame) -> pd.DataFrame:
    """With the steps of the sensors."""
    steps = {name: sensor["quantum"] for name, sensor in tables["sensors"].items() if sensor.get("quantum")}
    return table.assign(**{name: np.round(table[name] / step) * step for name, step in steps.items()})
