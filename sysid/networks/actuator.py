"""Actuator networks: cylinder displacement ↔ joint angle, one network per direction, fitted on manual operation.

Source: the paper's actuator networks 2 and 3. Motion capture measures the joint, a draw wire the cylinder; the rows have any
speed, so the map is the mean over speeds and directions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.errors import ExcitationError
from sysid.networks.member import Checkpoints, EnsembleMember, LearningCurve, TrainedMember
from sysid.networks.mlp import Mlp
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.split import SignalRows, gather, joined, measures, segments, stratified_sample, thin
from sysid.networks.training import train
from sysid.networks.uncertainty import Mask, NetworkUncertainty, required
from sysid.progress import Progress
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Least number of rows of each role.
MIN_ROWS = 100
DIRECTIONS = ("to_joint", "to_cylinder")


@dataclass(frozen=True)
class RoundTripError:
    """Errors of joint → cylinder → joint [rad] and of cylinder → joint → cylinder [m]."""

    joint_rmse: float
    joint_max: float
    cylinder_rmse: float
    cylinder_max: float

    @staticmethod
    def of(joint_error: Array, cylinder_error: Array) -> RoundTripError:
        """From the errors of the rows, (n,) [rad] and (m,) [m]."""
        return RoundTripError(
            joint_rmse=float(np.sqrt(np.mean(joint_error**2))),
            joint_max=float(np.abs(joint_error).max()),
            cylinder_rmse=float(np.sqrt(np.mean(cylinder_error**2))),
            cylinder_max=float(np.abs(cylinder_error).max()),
        )


@dataclass(frozen=True)
class ActuatorNetwork:
    """Both directions of one axis; satisfies :class:`sysid.machine.CylinderJointMap`.

    Args:
        axis: its name.
        to_joint: displacement [m] → joint [rad].
        to_cylinder: joint [rad] → displacement [m].
        displacements, joints: range of the fit rows; outside it a network extrapolates linearly.
        learning_curves: by direction.
        uncertainty: direction → intervals and training domain; empty for a version of an earlier release.
    """

    axis: str
    to_joint: Mlp
    to_cylinder: Mlp
    displacements: tuple[float, float]
    joints: tuple[float, float]
    learning_curves: Mapping[str, LearningCurve] = field(default_factory=dict)
    uncertainty: Mapping[str, NetworkUncertainty] = field(default_factory=dict)

    def joint(self, displacement: Array) -> Array:
        """Displacement [m] → joint angle [rad], same shape."""
        return _apply(self.to_joint, displacement)

    def displacement(self, joint: Array) -> Array:
        """Joint angle [rad] → displacement [m], same shape."""
        return _apply(self.to_cylinder, joint)

    def predict_interval(self, direction: str, values: Array, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper bounds for ``to_joint`` [rad] or ``to_cylinder`` [m], (n,) each, that contain a measurement with
        probability ``level`` or more where :meth:`inside` is true.

        Raises:
            InputError: a level that the calibration rows do not support, or a version without intervals.
        """
        uncertainty = required(self.uncertainty.get(direction), f"actuator network of {self.axis}")
        reach = uncertainty.intervals.reach(np.zeros((len(values), 1)), level)[:, 0]
        middle = self.joint(values) if direction == "to_joint" else self.displacement(values)
        return middle - reach, middle + reach

    def inside(self, direction: str, values: Array) -> Mask:
        """Whether displacements (``to_joint``) or joint angles (``to_cylinder``), (n,), lie in the training domain, (n,)."""
        uncertainty = required(self.uncertainty.get(direction), f"actuator network of {self.axis}")
        return uncertainty.domain.inside(np.asarray(values, dtype=np.float64).reshape(-1, 1))

    def round_trip(self, points: int = 512) -> RoundTripError:
        """Whether the two directions, which are fitted separately, invert each other, evenly over the fitted range."""
        joints, displacements = np.linspace(*self.joints, points), np.linspace(*self.displacements, points)
        joint_error = self.joint(self.displacement(joints)) - joints
        cylinder_error = self.displacement(self.joint(displacements)) - displacements
        return RoundTripError.of(joint_error, cylinder_error)


def fit_actuator(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> dict[str, ActuatorNetwork]:
    """Fit both directions for every axis whose cylinder and joint were measured together.

    Fit rows: ``samples`` of the ``fit`` recordings and the first static poses, stratified over the stroke. Early-stopping rows:
    as many of the ``select`` recordings, and the next poses. ``held_out`` rows are not read.

    Args:
        checkpoints: folder from which the same fit resumes after an interruption.

    Returns:
        Axis → network, in kinematic order.

    Raises:
        ExcitationError: no axis has both signals, too few rows, or a cylinder that did not move.
        SettingsError: the recipe names an unknown axis, or training diverges.
    """
    recipe.check_axes(dataset.machine.axis_names)
    axes = cylinder_axes(dataset)
    if not axes:
        raise ExcitationError(
            f"dataset {dataset.reference}",
            "no axis with both <axis>.cylinder and <axis>.joint",
            "at least one axis on which cylinder and joint were measured together",
            "Map both in the recipe of the dataset.",
        )
    members: dict[tuple[str, str], EnsembleMember] = {}
    ranges: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {}
    for axis in axes:
        fit, select = actuator_rows(dataset, axis, recipe)
        low, high = fit.values.min(axis=0), fit.values.max(axis=0)
        ranges[axis] = ((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))
        for direction, source, target in (("to_joint", 0, 1), ("to_cylinder", 1, 0)):
            members[axis, direction] = EnsembleMember(
                name=f"{axis} {direction}",
                inputs=fit.values[:, [source]],
                outputs=fit.values[:, [target]],
                validation_inputs=select.values[:, [source]],
                validation_outputs=select.values[:, [target]],
                input_names=(fit.signals[source],),
                output_names=(fit.signals[target],),
                hidden=recipe.actuator.layers(axis),
                rectifier=recipe.actuator.rectifier,
            )
    settings = recipe.actuator.training
    results = train(list(members.values()), recipe.actuator.hidden, settings, recipe.seed, progress, checkpoints)
    trained = dict(zip(members, results, strict=True))
    return {
        axis: ActuatorNetwork(
            axis=axis,
            to_joint=trained[axis, "to_joint"].mlp,
            to_cylinder=trained[axis, "to_cylinder"].mlp,
            displacements=ranges[axis][0],
            joints=ranges[axis][1],
            learning_curves={direction: trained[axis, direction].curve for direction in DIRECTIONS},
            uncertainty=_uncertainty(
                {direction: (members[axis, direction], trained[axis, direction]) for direction in DIRECTIONS}
            ),
        )
        for axis in axes
    }


def _uncertainty(results: Mapping[str, tuple[EnsembleMember, TrainedMember]]) -> dict[str, NetworkUncertainty]:
    """Calibrated on the early-stopping rows, since errors on the fit rows are too small."""
    found = {}
    for direction, (member, trained) in results.items():
        errors = member.validation_outputs - trained.mlp.predict(member.validation_inputs)
        uncertainty = NetworkUncertainty.of(member.inputs, errors, np.zeros(errors.shape))
        if uncertainty is not None:
            found[direction] = uncertainty
    return found


def cylinder_axes(dataset: Dataset) -> tuple[str, ...]:
    """Axes on which some motion recording measured cylinder and joint at the same time."""
    signals = {axis: (axis_signal(axis, "cylinder"), axis_signal(axis, "joint")) for axis in dataset.machine.axis_names}
    return tuple(axis for axis, both in signals.items() if measures(dataset, both, "motion"))


def actuator_rows(dataset: Dataset, axis: str, recipe: NetworkRecipe) -> tuple[SignalRows, SignalRows]:
    """Fit rows and select rows (cylinder, joint) of one axis.

    Raises:
        ExcitationError: fewer than ``MIN_ROWS`` of either.
    """
    signals = (axis_signal(axis, "cylinder"), axis_signal(axis, "joint"))
    fit = gather(segments(dataset, "fit", signals), signals)
    select = gather(segments(dataset, "select", signals), signals)
    for rows, role in ((fit, "fit"), (select, "select")):
        if len(rows) < MIN_ROWS:
            raise ExcitationError(
                f"dataset {dataset.reference}: axis {axis!r}",
                f"{len(rows)} {role} rows with both cylinder and joint",
                f"at least {MIN_ROWS}",
                "Record more manual operation.",
            )
    select = thin(select, recipe.actuator.samples)
    if "poses" in recipe.actuator.rows and measures(dataset, signals, "poses"):
        fit = joined(fit, gather(segments(dataset, "fit", signals, "poses"), signals))
        select = joined(select, gather(segments(dataset, "select", signals, "poses"), signals))
    rng = np.random.default_rng([recipe.seed, dataset.machine.axis_names.index(axis)])
    return fit.take(stratified_sample(fit.values[:, 0], recipe.actuator.samples, rng)), select


def _apply(mlp: Mlp, values: Array) -> Array:
    values = np.asarray(values, dtype=np.float64)
    return mlp.predict(values.reshape(-1, 1)).reshape(values.shape)
