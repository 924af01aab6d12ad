"""Actuator networks: cylinder displacement ↔ joint angle, one network a direction, learned from manual operation.

Source: the paper's actuator networks 2 and 3. Motion capture measures the joint, a draw wire the cylinder; both are sampled at
any speed, so the map is the mean over speeds and directions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.errors import ExcitationError
from sysid.networks.checkpoint import Checkpoints
from sysid.networks.member import EnsembleMember, LearningCurve, TrainedMember
from sysid.networks.mlp import Mlp
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.split import SignalRows, gather, joined, measures, segments, spread_sample, thin
from sysid.networks.training import train
from sysid.networks.uncertainty import Mask, NetworkUncertainty, known
from sysid.progress import Progress
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Fewer rows than this cannot fill the stroke.
MIN_ROWS = 100
DIRECTIONS = ("to_joint", "to_cylinder")


@dataclass(frozen=True)
class RoundTripError:
    """How far a value is from where it went: joint → cylinder → joint [rad] and back [m], evenly over the fitted range."""

    joint_rmse: float
    joint_max: float
    cylinder_rmse: float
    cylinder_max: float


@dataclass(frozen=True)
class ActuatorNetwork:
    """Both directions of one axis; satisfies :class:`sysid.machine.CylinderJointMap`.

    Args:
        axis: whose cylinder.
        to_joint: displacement [m] → joint [rad].
        to_cylinder: joint [rad] → displacement [m].
        displacements, joints: range of the rows it was fitted on; beyond it a network extrapolates in straight lines.
        courses: direction → how its training went.
        trust: direction → intervals, and where the data were; nothing for a version that does not know them.
    """

    axis: str
    to_joint: Mlp
    to_cylinder: Mlp
    displacements: tuple[float, float]
    joints: tuple[float, float]
    courses: Mapping[str, LearningCurve] = field(default_factory=dict)
    trust: Mapping[str, NetworkUncertainty] = field(default_factory=dict)

    def joint(self, displacement: Array) -> Array:
        """Displacement [m] → joint angle [rad], same shape."""
        return _apply(self.to_joint, displacement)

    def displacement(self, joint: Array) -> Array:
        """Joint angle [rad] → displacement [m], same shape."""
        return _apply(self.to_cylinder, joint)

    def predict_interval(self, direction: str, values: Array, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper ends for ``to_joint`` [rad] or ``to_cylinder`` [m], (n,) each, between which a measurement lies at
        least as often as ``level`` wherever :meth:`inside` holds.

        Raises:
            InputError: a level that the rows it was evaluated on cannot tell, or a version that does not know its intervals.
        """
        trust = known(self.trust.get(direction), f"actuator network of {self.axis}")
        reach = trust.intervals.reach(np.zeros((len(values), 1)), level)[:, 0]
        middle = self.joint(values) if direction == "to_joint" else self.displacement(values)
        return middle - reach, middle + reach

    def inside(self, direction: str, values: Array) -> Mask:
        """Whether displacements (``to_joint``) or joint angles (``to_cylinder``), (n,), lie where the data were, (n,)."""
        trust = known(self.trust.get(direction), f"actuator network of {self.axis}")
        return trust.domain.inside(np.asarray(values, dtype=np.float64).reshape(-1, 1))

    def round_trip(self, points: int = 512) -> RoundTripError:
        """Whether the two directions, which were learned apart, are inverses of each other."""
        joints, displacements = np.linspace(*self.joints, points), np.linspace(*self.displacements, points)
        joint_error = self.joint(self.displacement(joints)) - joints
        cylinder_error = self.displacement(self.joint(displacements)) - displacements
        return RoundTripError(
            joint_rmse=float(np.sqrt(np.mean(joint_error**2))),
            joint_max=float(np.abs(joint_error).max()),
            cylinder_rmse=float(np.sqrt(np.mean(cylinder_error**2))),
            cylinder_max=float(np.abs(cylinder_error).max()),
        )


def fit_actuator(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> dict[str, ActuatorNetwork]:
    """Fit both directions for every axis whose cylinder and joint were measured together.

    Rows to learn from: ``samples`` of the ``fit`` recordings and of the first static poses, spread over the stroke; as many
    of the ``select`` recordings, and the poses after those, decide when to stop. ``held_out`` rows are not looked at.

    Args:
        checkpoints: where a fit that is interrupted is kept; the same fit goes on from there.

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
            courses={direction: trained[axis, direction].course for direction in DIRECTIONS},
            trust=_trusted({direction: (members[axis, direction], trained[axis, direction]) for direction in DIRECTIONS}),
        )
        for axis in axes
    }


def _trusted(results: Mapping[str, tuple[EnsembleMember, TrainedMember]]) -> dict[str, NetworkUncertainty]:
    """From the rows that decided when to stop: those that taught are reproduced better than any other."""
    found = {}
    for direction, (member, trained) in results.items():
        errors = member.validation_outputs - trained.mlp.predict(member.validation_inputs)
        trust = NetworkUncertainty.of(member.inputs, errors, np.zeros(errors.shape))
        if trust is not None:
            found[direction] = trust
    return found


def cylinder_axes(dataset: Dataset) -> tuple[str, ...]:
    """Axes on which some motion recording measured cylinder and joint at the same time."""
    signals = {axis: (axis_signal(axis, "cylinder"), axis_signal(axis, "joint")) for axis in dataset.machine.axis_names}
    return tuple(axis for axis, both in signals.items() if measures(dataset, both, "motion"))


def actuator_rows(dataset: Dataset, axis: str, recipe: NetworkRecipe) -> tuple[SignalRows, SignalRows]:
    """The rows (cylinder, joint) that one axis is fitted and validated on.

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
    return fit.take(spread_sample(fit.values[:, 0], recipe.actuator.samples, rng)), select


def _apply(mlp: Mlp, values: Array) -> Array:
    values = np.asarray(values, dtype=np.float64)
    return mlp.predict(values.reshape(-1, 1)).reshape(values.shape)
