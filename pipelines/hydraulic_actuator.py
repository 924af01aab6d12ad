"""Hydraulic actuator: the gap of an arm simulated as an integrator of its valve, and its oil pressure from the motion.

    .venv/bin/python pipelines/hydraulic_actuator.py FOLDER_WITH_THE_MAT_FILES   (source: datasets/hydraulic_actuator/README.md)

The benchmark is the oil pressure from the valve opening, free-running on the second half. The chain here is valve → motion (the
plant) → pressure from inertia, friction and weight of the arm (four numbers from the first half). The pressure from the
measured motion is given as well.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from repeatability import repeatability, show_repeatability
from sysid.cli.gap_tables import show_gap
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.datasets import Dataset, Recording, ingest
from sysid.gap import find_gap
from sysid.logs import ReadOptions, reader_named
from sysid.machine import KnownEffect
from sysid.plant import Plant, free_run
from sysid.reports import write_report
from sysid.workspace import open_workspace

Array = npt.NDArray[np.float64]
CONTENT = Path(__file__).resolve().parents[1] / "datasets" / "hydraulic_actuator"
FILE, HALF, SPAN = "actuator_u_p_x.mat", 512, 1.5
#: Free-run RMS on the second half, from the literature.
LITERATURE = {"linear": 1.016, "wavelet network": 0.579, "neural network": 0.467}
#: Lags of pressure and valve in the linear model that is fitted here for comparison.
LAGS = (3, 3)
#: Corner of the low-pass of the position before it is differentiated [share of the sample rate].
CORNER = 0.1


def main(raw: Path, workspace: Path) -> Path:
    """Run the line on the files in ``raw`` and return the path of ``<workspace>/hydraulic_actuator/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "hydraulic_actuator"
    folder.mkdir(parents=True, exist_ok=True)
    station = PipelineProgress(out)

    with station("ingest") as progress:
        dataset = ingest(raw, workspace, recipe=CONTENT / "recipe.toml", progress=progress)
    plant = place.plant(dataset)  # speed = gain · valve opening, nothing else
    with station("gap") as progress:
        gap = find_gap(dataset, plant, place.models, add=True, progress=progress)
        place.keep_gap(dataset, gap)
    with station("gap, blocks exchanged"):
        runs = {"as split": gap, "fit and select exchanged": find_gap(exchanged(dataset), plant)}
    with station("report"):
        page = write_report(folder / "report.html", place.report_inputs(dataset))
    show_gap(out, gap, dataset)
    repeats = repeatability(runs)
    out.line("Fitted on either block of the first half")
    show_repeatability(out, repeats, dataset.machine)

    valve, pressure, position = columns(raw, dataset.machine.rate_hz)
    errors = {
        f"linear, lags {LAGS[0]} and {LAGS[1]}": linear_error(pressure, valve),
        "measured motion": motion_error(pressure, position),
        "simulated motion, nominal": motion_error(pressure, simulated(plant, valve, position)),
        "simulated motion, gain by direction": motion_error(
            pressure, simulated(by_direction(plant, valve, position), valve, position)
        ),
    }
    if gap.plant_after:
        repaired = place.plant(dataset, gap.plant_after)
        errors["simulated motion, repaired"] = motion_error(pressure, simulated(repaired, valve, position))
    out.line("Pressure on the second half, free run from the valve alone (but for “measured motion”): RMS")
    rows = [(name, "here", f"{value:.3f}") for name, value in errors.items()]
    out.table(("model", "source", "RMS"), [*rows, *((k, "literature", f"{v:.3f}") for k, v in LITERATURE.items())], right=(2,))

    result: dict[str, Any] = {"schema": 1, "dataset": dataset.reference, "gap": gap.to_json(), "pressure": errors}
    result |= {"exchanged": runs["fit and select exchanged"].to_json(), "stability": [item.to_json() for item in repeats]}
    result |= {"literature": LITERATURE, "seconds": station.seconds, "files": {"report": page}}
    write_json(folder / "result.json", result)
    out.block(f"Report   {page}\nFigures  {folder / 'result.json'}")
    return folder / "result.json"


def exchanged(dataset: Dataset) -> Dataset:
    """The dataset with the roles of its fit and selection recordings exchanged."""
    roles = {"fit": "select", "select": "fit", "held_out": "held_out"}
    return replace(dataset, splits={name: roles[role] for name, role in dataset.splits.items()})  # type: ignore[misc]


def columns(raw: Path, rate_hz: float) -> tuple[Array, Array, Array]:
    """Valve opening, pressure and position, each (1024,)."""
    (log,) = reader_named("mat", CONTENT).read(raw / FILE, ReadOptions(rate_hz=rate_hz))
    return log.columns["u"], log.columns["p"], log.columns["x"]


def simulated(plant: Plant, valve: Array, position: Array) -> Array:
    """Free run of the position over each half, started where that half was measured to start."""
    rate = plant.machine.rate_hz
    parts = []
    for half in (slice(0, HALF), slice(HALF, None)):
        table = {"arm.command": -valve[half] / SPAN, "arm.joint": position[half]}
        frame = pd.DataFrame({"time": np.arange(len(position[half])) / rate, **table})
        parts.append(free_run(plant, Recording("half", frame, rate))["arm.joint"].to_numpy())
    return np.concatenate(parts)


def by_direction(plant: Plant, valve: Array, position: Array) -> Plant:
    """The plant with a speed for either sign of the valve, least squares on the first half: no search, no evaluation."""
    command, speed = -valve[:HALF] / SPAN, np.gradient(position[:HALF]) * plant.machine.rate_hz
    sides = np.column_stack([np.maximum(command, 0.0), np.minimum(command, 0.0)])
    up, down = np.linalg.lstsq(sides, speed, rcond=None)[0]
    ratio = KnownEffect("gain_error", "arm", {"ratio": float(up / plant.machine.axis("arm").gain)})
    return plant.with_effect(ratio).with_effect(KnownEffect("asymmetric_gain", "arm", {"ratio": float(down / up)}))


def motion_error(pressure: Array, motion: Array) -> float:
    """RMS on the second half of the pressure that inertia, friction and weight make of ``motion``, fitted on the first half."""
    weights = np.linalg.lstsq(of_motion(motion[:HALF]), pressure[:HALF], rcond=None)[0]
    return rms(pressure[HALF:] - of_motion(motion[HALF:]) @ weights)


def of_motion(position: Array) -> Array:
    """(n, 4): acceleration, speed, its sign and a constant; per sample, the position low-passed without a delay."""
    speed = np.gradient(sosfiltfilt(butter(4, 2.0 * CORNER, output="sos"), position))
    moving = np.abs(speed) > 0.02 * np.max(np.abs(speed))
    return np.column_stack([np.gradient(speed), speed, np.sign(speed) * moving, np.ones_like(speed)])


def linear_error(pressure: Array, valve: Array) -> float:
    """RMS on the second half of a linear difference equation, fitted by least squares on the first half, free-running."""
    own, other = LAGS
    first = max(own, other)

    def row(output: Array, k: int) -> Array:
        return np.concatenate([output[k - own : k][::-1], valve[k - other + 1 : k + 1][::-1]])

    table = np.array([row(pressure, k) for k in range(first, HALF)])
    weights = np.linalg.lstsq(table, pressure[first:HALF], rcond=None)[0]
    run = pressure.copy()
    for k in range(HALF, len(run)):
        run[k] = row(run, k) @ weights
    return rms(pressure[HALF:] - run[HALF:])


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help=f"folder with {FILE}")
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    given = parser.parse_args()
    main(given.raw, given.workspace)
