"""Recordings of a case: CSV logs with canonical names, with noise and quantisation of the sensors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from hidden.foreign.excitation import Program, Take
from hidden.foreign.machines import FORCE_AXIS, Tables, noise_of
from hidden.foreign.simulate import simulate

#: Programs of the recordings, the last one held out, and lengths of a posed machine's and of a force axis' recordings [s].
RICH: tuple[Program, ...] = ("operator", "steps", "fourier", "operator", "operator", "steps")
PROGRAMS: dict[str, tuple[Program, ...]] = {
    "rich": RICH,
    "moving": RICH,
    "operator": ("operator",) * 6,
    "poor": ("operator",) * 3,
}
LENGTHS, PUSHED = (40.0, 60.0), (15.0, 20.0)
#: Recordings that begin in motion in cases of that kind, the held-out one included; duration of the motion before [s], and
#: initial deflection of a hanging tool [rad].
MOVING, LEAD, SWING = (1, 3, 5), (2.0, 6.0), 0.3


def takes_of(tables: Tables, excitation: str, seed: int) -> list[Take]:
    """The recordings of a case."""
    draw = np.random.default_rng([seed, 2])
    low, high = PUSHED if tables["family"] in FORCE_AXIS else LENGTHS
    found = []
    for k, program in enumerate(PROGRAMS[excitation]):
        moving = excitation == "moving" and k in MOVING
        lead = float(draw.uniform(*LEAD)) if moving else 0.0
        swing = (float(draw.normal(0.0, SWING)), float(draw.normal(0.0, SWING))) if moving else (0.0, 0.0)
        length = round(float(draw.uniform(low, high)), 1)
        found.append(Take(f"take-{k + 1}", seed + 13 * k, length if excitation != "poor" else low, program, lead, swing))
    return found


def write_logs(tables: Tables, takes: Sequence[Take], noise: float, seed: int, folder: Path) -> None:
    """``folder/<recording>/<stream>.csv``: the controller's log, and the points in a separate stream of the camera."""
    spread = noise_of(tables, noise)
    for k, take in enumerate(takes):
        table = simulate(tables, take)
        draw = np.random.default_rng([seed, k, 1])
        shown = {}
        for name in table.columns:
            if name == "time":
                continue
            noisy = table[name].to_numpy() + spread.get(name, 0.0) * draw.standard_normal(len(table))
            step = tables["sensors"].get(name, {}).get("quantum", 0.0)
            shown[name] = np.round(noisy / step) * step if step else noisy
        points = [name for name in shown if name.split(".")[0] in ("ee", "tool")]
        streams = {"machine": [name for name in shown if name not in points], "camera": points}
        for stream, names in streams.items():
            if not names:
                continue
            path = folder / take.name / f"{stream}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            columns = pd.DataFrame({"time": table["time"], **{name: shown[name] for name in names}})
            columns.to_csv(path, index=False, float_format="%.9g")
