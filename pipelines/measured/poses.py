"""Static poses of two arms that other people measured: frame and marker unknown, few poses, mistakes among them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from sklearn.model_selection import RepeatedKFold, ShuffleSplit

from committed import markdown
from sysid.datasets.recipe import load_recipe
from sysid.machine import Machine, load_machine
from sysid.machine.kinematics import Kinematics
from sysid.networks import Geometry, calibrate
from sysid.networks.estimator import NetworkRegressor, cross_validate
from sysid.networks.forward import to_features
from sysid.signals import axis_signal, point_signals
from sysid.validate.baselines import baseline_models

Array = npt.NDArray[np.float64]
Predict = Callable[[Array], Array]
DATASETS = Path(__file__).resolve().parents[2] / "datasets"
FOLDS, REPEATS, CURVE_REPEATS = 5, 4, 12


@dataclass(frozen=True)
class Arm:
    """A set of poses.

    Args:
        name: of its folder in ``datasets/``; ``file``: of the table.
        curve: numbers of poses of the learning curve.
        published: what its publishers reached, in words.
    """

    name: str
    title: str
    file: str
    curve: tuple[int, ...]
    published: str


ARMS = (
    Arm(
        "tiago", "TIAGo", "qualysis_base_hand_calibration.csv", (10, 14, 18, 22, 27),
        "all 34 poses fitted and evaluated: registration 4.7–4.8 mm, full calibration 2.6–3.6 mm RMS; sessions without "
        "the fault of the clock, evaluated on other days: registration 4.2–4.9 mm, full calibration 2.4–3.1 mm",
    ),
    Arm("ur10", "UR10", "ur10_calibration.csv", (10, 12, 14, 16, 18), "none"),
)  # fmt: skip


def evaluated(arm: Arm, folder: Path, quick: bool = False) -> dict[str, Any]:
    """Errors of every model on poses that it has not seen [mm], and the learning curve of the calibrated geometry."""
    machine = load_machine(DATASETS / arm.name / "machine.toml")
    q, tip = read(arm, machine, folder)
    folds = list(RepeatedKFold(n_splits=FOLDS, n_repeats=1 if quick else REPEATS, random_state=0).split(q))
    errors: dict[str, list[Array]] = {}
    for fit, held in folds:
        for name, predict in models(machine, q[fit], tip[fit]).items():
            errors.setdefault(name, []).append(predict(q[held]) - tip[held])
    errors["perceptrons, mean of five"] = perceptrons(machine, q, tip, folds)
    curve = {}
    for count in arm.curve:
        parts: dict[str, list[Array]] = {}
        splits = ShuffleSplit(3 if quick else CURVE_REPEATS, train_size=count, random_state=count)
        for fit, held in splits.split(q):
            for name, predict in geometric(machine, q[fit], tip[fit]).items():
                parts.setdefault(name, []).append(predict(q[held]) - tip[held])
        curve[str(count)] = {name: figures(each) for name, each in parts.items()}
    return {
        "title": arm.title,
        "poses": len(q),
        "folds": len(folds),
        "published": arm.published,
        "models": {name: figures(each) for name, each in errors.items()},
        "curve": curve,
    }


def read(arm: Arm, machine: Machine, folder: Path) -> tuple[Array, Array]:
    """Joint values (n, n_axes) [rad or m] and measured points (n, 3) [m]; columns as the recipe maps them."""
    (stream,) = load_recipe(DATASETS / arm.name / "recipe.toml").streams
    table = pd.read_csv(folder / arm.file)
    joints = [axis_signal(axis, "joint") for axis in machine.axis_names]

    def columns(signals: list[str]) -> Array:
        return np.column_stack([table[stream.signals[signal].field] for signal in signals]).astype(np.float64)

    return columns(joints), columns(list(point_signals("ee")))


def models(machine: Machine, q: Array, tip: Array) -> dict[str, Predict]:
    """Geometry, with and without its calibration, and the simple models, all of the same poses."""
    revolute = angles(machine)
    simple = baseline_models(to_features(q, revolute, "sincos"), tip)
    found = {
        name: lambda x, each=each: each(to_features(x, revolute, "sincos"))  # type: ignore[misc]
        for name, each in simple.items()
    }
    return geometric(machine, q, tip) | found


def geometric(machine: Machine, q: Array, tip: Array) -> dict[str, Predict]:
    """The published geometry with capture frame and marker fitted, and with everything calibrated beside them."""
    placed = registered(machine, q, tip)
    geometry = Geometry(placed)
    unknown = np.full(q.shape[1], np.nan), np.full(3, np.nan)
    return {
        "published geometry, frame and marker fitted": placed.tip_position,
        "geometry calibrated (structured)": calibrate(geometry, q, tip, *unknown).predict,
    }


def registered(machine: Machine, q: Array, tip: Array) -> Kinematics:
    """The machine's kinematics in the frame of the capture, with the tip where the marker is: nine numbers, nothing else."""
    kinematics = machine.kinematics()
    assert kinematics is not None
    assert machine.urdf_text is not None
    marker = next(joint for joint in kinematics.chain if joint.child == kinematics.tip)
    base = kinematics.chain[0].parent
    last = kinematics.link_poses(q)[marker.parent]

    def errors(v: Array) -> Array:
        point = last[:, :3, 3] + last[:, :3, :3] @ v[6:]
        return np.asarray((Rotation.from_rotvec(v[:3]).apply(point) + v[3:6] - tip).ravel())

    starts = [np.r_[Rotation.from_euler("z", angle).as_rotvec(), np.zeros(6)] for angle in np.linspace(-np.pi, np.pi, 8)[:-1]]
    best = min(
        (least_squares(errors, start, loss="soft_l1", f_scale=5e-3) for start in starts), key=lambda fit: float(fit.cost)
    ).x
    robot = ElementTree.fromstring(machine.urdf_text)
    for joint in robot.findall("joint"):
        if joint.get("name") == marker.name:
            joint.find("origin").set("xyz", vector(best[6:]))  # type: ignore[union-attr]
    ElementTree.SubElement(robot, "link", name="capture")
    frame = ElementTree.SubElement(robot, "joint", name="capture_joint", type="fixed")
    ElementTree.SubElement(frame, "parent", link="capture")
    ElementTree.SubElement(frame, "child", link=base)
    rpy = Rotation.from_rotvec(best[:3]).as_euler("xyz")
    ElementTree.SubElement(frame, "origin", xyz=vector(best[3:6]), rpy=vector(rpy))
    return Kinematics.from_urdf(ElementTree.tostring(robot, "unicode"), kinematics.actuated, kinematics.tip)


def vector(values: Array) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def perceptrons(machine: Machine, q: Array, tip: Array, folds: list[tuple[Any, Any]]) -> list[Array]:
    """Errors of a mean of five on the same folds, all trained together."""
    inputs = to_features(q, angles(machine), "sincos")
    network = NetworkRegressor((64, 64), members=5, batch=8, epochs=400, learning_rate=1e-3, validation_fraction=0.15)
    done = cross_validate(network, inputs, tip, cv=folds)
    assert isinstance(done, dict)
    return [model.predict(inputs[held]) - tip[held] for model, (_, held) in zip(done["estimator"], folds, strict=True)]


def angles(machine: Machine) -> tuple[bool, ...]:
    """Which joints are angles."""
    return tuple(machine.expected_unit(axis_signal(axis, "joint")) == "rad" for axis in machine.axis_names)


def figures(parts: list[Array]) -> dict[str, Any]:
    """Of errors (n, 3) [m] of several folds: RMSE of each coordinate and of the distance, its 95 % and maximum [mm]."""
    errors = 1e3 * np.concatenate(parts)
    distance = np.linalg.norm(errors, axis=1)
    return {
        "rmse": np.sqrt(np.mean(errors**2, axis=0)).tolist(),
        "distance_rmse": float(np.sqrt(np.mean(distance**2))),
        "distance_median": float(np.median(distance)),
        "distance_p95": float(np.percentile(distance, 95)),
        "distance_max": float(distance.max()),
    }


def tables(arms: Mapping[str, Mapping[str, Any]]) -> str:
    """Errors by model and arm, and the learning curves, in Markdown."""
    parts = []
    for arm in arms.values():
        rows = [
            [name, ", ".join(f"{value:.2f}" for value in found["rmse"])]
            + [f"{found[f'distance_{key}']:.2f}" for key in ("rmse", "median", "p95", "max")]
            for name, found in sorted(arm["models"].items(), key=lambda item: float(item[1]["distance_median"]))
        ]
        counts = list(arm["curve"])
        curve = []
        for name in arm["curve"][counts[0]]:
            cells = (arm["curve"][count][name] for count in counts)
            curve.append([name, *(f"{cell['distance_median']:.2f} ({cell['distance_rmse']:.2f})" for cell in cells)])
        parts += [
            f"**{arm['title']}**, {arm['poses']} poses, {arm['folds']}-fold cross-validation. Published: {arm['published']}.",
            markdown(["model", "RMSE x, y, z [mm]", "distance, RMSE", "median", "95 %", "max"], rows),
            markdown([f"{arm['title']}, training poses: median (RMSE) of the distance [mm]", *counts], curve),
        ]
    return "\n\n".join(parts)
