"""Double pendulum: friction of two quasi-direct drives, without and with a controller that compensates for it.

    .venv/bin/python pipelines/double_pendulum.py FOLDER_WITH_THE_LOGS         (source: datasets/double_pendulum/README.md)

The logged torque is the command to the motor, compensation included. With it the four logs are of one machine with friction;
without it, as the controller without its compensation sees the machine, the held-out log is of one without.
"""

from __future__ import annotations

import argparse
import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import least_squares
from scipy.signal import butter, filtfilt

from sysid.cli.gap_tables import show_gap
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.config import read_toml
from sysid.datasets import Dataset, Recording, ingest
from sysid.gap import GapResult, find_gap
from sysid.reports import write_report
from sysid.workspace import open_workspace

Array = npt.NDArray[np.float64]

CONTENT = Path(__file__).resolve().parents[1] / "datasets" / "double_pendulum"
AXES = ("shoulder", "elbow")
COMPENSATED = "compensated"
#: Coefficients of arctan(100·speed) [N·m] and of the speed [N·m·s/rad]: of the fit with friction (model_2.0), and of the
#: compensation. Dry friction at speed is π/2 of the first.
MODEL = {"shoulder": (0.093, 0.001), "elbow": (0.078, 0.001)}
COMPENSATION = {"shoulder": (0.093, 0.186), "elbow": (0.081, 0.0)}
#: Usual speeds, at which friction is compared [rad/s].
SPEED = {"shoulder": 2.0, "elbow": 4.0}
#: Length of the upper link [m], gravity [m/s²].
LENGTH, GRAVITY = 0.3, 9.81
#: The regression: low-pass of torque and motion [Hz], and what it distorts at both ends of a recording [s].
LOW_PASS_HZ, ENDS_S = 10.0, 0.3
#: First moment and inertia of the upper link with the lower one at its end, and of the lower link [kg·m, kg·m²], inertia of the
#: elbow's rotor [kg·m²]; then dry and viscous friction of both axes.
RIGID = ("moment_1", "inertia_1", "moment_2", "inertia_2", "rotor_2")
FRICTION = tuple(f"{axis}.{kind}" for kind in ("dry", "viscous") for axis in AXES)


def main(raw: Path, workspace: Path) -> Path:
    """Run the line on the logs in ``raw`` and return the path of ``<workspace>/double_pendulum/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "double_pendulum"
    station = PipelineProgress(out)
    file = read_toml(CONTENT / "recipe.toml")["recordings"]["files"][COMPENSATED]
    compensation = compensation_of(read_log(raw / file))
    logs = {"motor": raw, "controller": without_compensation(raw, folder / "controller", file)}

    gaps: dict[str, GapResult] = {}
    pages: dict[str, Path] = {}
    for name, its in logs.items():
        with station(f"ingest, torque of the {name}") as progress:
            dataset = ingest(its, workspace, recipe=CONTENT / "recipe.toml", name=f"double_pendulum-{name}", progress=progress)
        if name == "motor":
            regression = rigid_regression(dataset)
        with station(f"gap, torque of the {name}") as progress:
            gaps[name] = find_gap(dataset, place.plant(dataset), place.models, add=True, world=False, progress=progress)
            place.keep_gap(dataset, gaps[name])
        pages[name] = write_report(folder / f"report-{name}.html", place.report_inputs(dataset))
        out.block(f"\nTorque of the {name}")
        show_gap(out, gaps[name], dataset)

    out.line("Compensation in the logged torque, from its steps: coefficients of arctan(100·speed) and of the speed")
    rows = [
        (
            axis,
            f"{c['dry']:.4f} ± {c['dry_error']:.4f}",
            f"{c['viscous']:.3f} ± {c['viscous_error']:.3f}",
            str(COMPENSATION[axis]),
        )
        for axis, c in compensation.items()
    ]
    out.table(("axis", "N·m", "N·m·s/rad", "published"), rows)
    found = {axis: tuple(regression[f"{axis}.{kind}"] for kind in ("dry", "viscous")) for axis in AXES}
    published = {axis: {"model": at_speed(axis, MODEL), "compensation": at_speed(axis, COMPENSATION)} for axis in AXES}
    out.line("Friction at the usual speed [N·m], and what the gap writes")
    compared = []
    for axis, (dry, viscous) in found.items():
        values = (dry[0] + SPEED[axis] * viscous[0], *published[axis].values())
        compared.append((f"{axis}, {SPEED[axis]:g} rad/s", *(f"{v:.3f}" for v in values), friction_text(gaps["motor"], axis)))
    out.table(("axis", "regression", "model_2.0", "compensation", "gap"), compared)
    result: dict[str, Any] = {"schema": 1, "runs": {name: gap.to_json() for name, gap in gaps.items()}}
    result |= {"compensation": compensation, "regression": regression, "speed": SPEED, "published": published}
    result |= {"seconds": station.seconds, "files": pages}
    write_json(folder / "result.json", result)
    out.block("".join(f"Report   {page}\n" for page in pages.values()) + f"Figures  {folder / 'result.json'}")
    return folder / "result.json"


def read_log(path: Path) -> pd.DataFrame:
    table = pd.read_csv(path)
    return table.rename(columns=str.strip)


def law(axis: str, speed: Array) -> Array:
    """The torque that the controller adds [N·m]."""
    dry, viscous = COMPENSATION[axis]
    return np.asarray(dry * np.arctan(100.0 * speed) + viscous * speed)


def at_speed(axis: str, terms: Mapping[str, tuple[float, float]]) -> float:
    """Published friction at the usual speed of an axis [N·m]."""
    dry, viscous = terms[axis]
    return dry * math.atan(100.0 * SPEED[axis]) + viscous * SPEED[axis]


def compensation_of(log: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Its coefficients from the steps of the torque between rows, which follow the speed of the row before."""
    found = {}
    for k, axis in enumerate(AXES, start=1):
        torque, speed, angle = (log[f"{key}{k}"].to_numpy(float) for key in ("tau", "vel", "pos"))
        steps, before = np.diff(torque)[1:], slice(None, -2)
        basis = [np.arctan(100.0 * speed), speed, angle]
        columns = np.column_stack([*(np.diff(each)[:-1] for each in basis), np.ones(len(speed[before]))])
        values, *_ = np.linalg.lstsq(columns, steps, rcond=None)
        left = steps - columns @ values
        errors = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)) * np.var(left))
        found[axis] = {"dry": values[0], "dry_error": errors[0], "viscous": values[1], "viscous_error": errors[1]}
        found[axis] = {key: float(value) for key, value in found[axis].items()}
        found[axis]["explained"] = float(1.0 - np.var(left) / np.var(steps))
    return found


def without_compensation(raw: Path, folder: Path, file: str) -> Path:
    """The logs, with the compensation taken from the torques of ``file``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in read_toml(CONTENT / "recipe.toml")["recordings"]["files"].values():
        shutil.copyfile(raw / name, folder / name)
    log = read_log(raw / file)
    for k, axis in enumerate(AXES, start=1):
        log[f"tau{k}"] -= law(axis, np.concatenate([[0.0], log[f"vel{k}"].to_numpy(float)[:-1]]))
    log.to_csv(folder / file, index=False)
    return folder


def rigid_regression(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Rigid motion with dry and viscous friction, and the zero of every recording: value and standard error of each.

    One least-squares fit of the low-passed torques of both joints; two rows of the band's period count as independent.
    """
    recordings = [_filtered(recording) for recording in dataset.recordings]
    zeros = [f"{recording.name}.{axis}.zero" for recording in dataset.recordings for axis in AXES]
    names = (*RIGID, *FRICTION, *zeros)

    def residual(values: Array) -> Array:
        return np.concatenate([
            _left(values[: len(RIGID) + len(FRICTION)], values[len(RIGID) + len(FRICTION) + 2 * k :][:2], *recording)
            for k, recording in enumerate(recordings)
        ])  # fmt: skip

    start = np.array([0.35, 0.11, 0.11, 0.024, 0.003, 0.1, 0.1, *np.zeros(len(names) - 7)])
    fit = least_squares(residual, start)
    independent = 2.0 * LOW_PASS_HZ / dataset.recordings[0].rate_hz
    jacobian = np.asarray(fit.jac, dtype=np.float64)
    errors = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)) * np.var(fit.fun) / independent)
    return {name: (float(value), float(error)) for name, value, error in zip(names, fit.x, errors, strict=True)}


def _low_passed(values: Array, rate_hz: float) -> Array:
    b, a = butter(3, LOW_PASS_HZ / (0.5 * rate_hz))
    return np.asarray(filtfilt(b, a, values))


def _filtered(recording: Recording) -> tuple[Array, Array, float]:
    """Angles and torques (2, n), low-passed, and the rate."""
    inside = np.isfinite(np.array([recording.values(f"{axis}.{what}") for axis in AXES for what in ("command", "joint")])).all(
        0
    )
    angles, torques = (
        np.array([_low_passed(recording.values(f"{axis}.{what}")[inside], recording.rate_hz) for axis in AXES])
        for what in ("joint", "command")
    )
    return angles, torques, recording.rate_hz


def _left(values: Array, zero: Array, angles: Array, torques: Array, rate_hz: float) -> Array:
    """Torque that the model lacks, of both joints without the ends of the recording."""
    moment_1, inertia_1, moment_2, inertia_2, rotor_2 = values[: len(RIGID)]
    dry, viscous = values[len(RIGID) :].reshape(2, 2)
    speeds = np.gradient(angles, 1.0 / rate_hz, axis=1)
    (a1, a2), (v1, v2), (q1, q2) = np.gradient(speeds, 1.0 / rate_hz, axis=1), speeds, angles + zero[:, None]
    weight, turned = GRAVITY * np.sin(q1 + q2), LENGTH * np.cos(q2)
    elbow = moment_2 * (weight + turned * a1 + LENGTH * np.sin(q2) * v1**2) + inertia_2 * (a1 + a2) + rotor_2 * a2
    both = weight + turned * (2.0 * a1 + a2) - LENGTH * np.sin(q2) * (2.0 * v1 * v2 + v2**2)
    shoulder = GRAVITY * moment_1 * np.sin(q1) + inertia_1 * a1 + moment_2 * both + inertia_2 * (a1 + a2)
    friction = dry[:, None] * np.arctan(100.0 * speeds) * 2.0 / math.pi + viscous[:, None] * speeds
    model = np.array([_low_passed(each, rate_hz) for each in np.array([shoulder, elbow]) + friction])
    ends = round(ENDS_S * rate_hz)
    return np.asarray((torques - model)[:, ends:-ends].ravel())


def friction_text(gap: GapResult, axis: str) -> str:
    """Effects of friction that the gap writes for an axis, with the name where they have one."""
    named = {(effect.name, effect.target) for effect in gap.effects}
    parts = [
        f"{item['name']} {', '.join(f'{key} {value:.3g}' for key, value in item['parameters'].items())}"
        + ("" if (item["name"], axis) in named else " (no name)")
        for item in gap.to_json()["written"]
        if item["target"] == axis and "friction" in item["name"]
    ]
    return "; ".join(parts) or "none"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path)
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    given = parser.parse_args()
    main(given.raw, given.workspace)
