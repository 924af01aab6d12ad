"""Evaluation of networks on held-out recordings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Kind, Role
from sysid.errors import ExcitationError
from sysid.networks.actuator import DIRECTIONS, ActuatorNetwork, actuator_rows
from sysid.networks.artifacts import Model, history_networks, motion_networks, static_networks
from sysid.networks.forward import ForwardModel, ForwardNetwork, forward_rows
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.split import SignalRows, gather, measures, segments
from sysid.networks.structured import StructuredForward
from sysid.signals import axis_signal, point_signals
from sysid.validate.baselines import baseline_models, urdf_kinematics
from sysid.validate.error_analysis import Ranges
from sysid.validate.free_runs import validate_history, validate_motion
from sysid.validate.output_reports import EvaluatedOutput, actuator_output, output_report
from sysid.validate.report import ValidationReport

Array = npt.NDArray[np.float64]


def validate_model(
    model: Model, dataset: Dataset, role: Role = "held_out", recipe: NetworkRecipe | None = None, name: str = ""
) -> ValidationReport:
    """Report of a model of any kind, by the function for its kind."""
    if isinstance(model, ForwardNetwork | StructuredForward):
        return validate_forward(model, dataset, role, name)
    if motions := motion_networks(model):
        return validate_motion(motions, dataset, role, recipe, name)
    if histories := history_networks(model):
        return validate_history(histories, dataset, role, recipe, name)
    return validate_actuator(static_networks(model), dataset, role, recipe, name)


def validate_actuator(
    networks: Mapping[str, ActuatorNetwork],
    dataset: Dataset,
    role: Role = "held_out",
    recipe: NetworkRecipe | None = None,
    name: str = "",
) -> ValidationReport:
    """Both directions of every axis on all rows of ``role``: in motion, and at static poses that measure the cylinder.

    Args:
        networks: axis → network, from ``fit_actuator``.
        role: recordings to evaluate on.
        recipe: of the fit, so that the baselines are fitted on the same rows; default: the paper's.
        name: of the model, for the report.

    Raises:
        ExcitationError: no rows of that role have both signals of an axis.
    """
    outputs = []
    for axis, network in networks.items():
        signals = (axis_signal(axis, "cylinder"), axis_signal(axis, "joint"))
        fit, _ = actuator_rows(dataset, axis, recipe or NetworkRecipe())
        rows_by_kind = _rows_by_kind(dataset, role, signals, ("motion", "poses"))
        maps = [actuator_output(dataset, network, direction, fit) for direction in DIRECTIONS]
        outputs += [output_report(dataset, rows, kind, item) for kind, rows in rows_by_kind.items() for item in maps]
    round_trips = {axis: network.round_trip() for axis, network in networks.items()}
    return ValidationReport("actuator", name, dataset.reference, role, tuple(outputs), round_trips)


def validate_forward(network: ForwardModel, dataset: Dataset, role: Role = "held_out", name: str = "") -> ValidationReport:
    """End effector on the static poses of ``role``, and on its motion if it was measured.

    Raises:
        ExcitationError: neither poses nor motion of that role have all joints and the end effector.
    """
    signals = (*network.joints, *point_signals("ee"))
    count = len(network.joints)
    fit = forward_rows(dataset, "fit")
    fitted = dict(zip(network.joints, zip(network.low.tolist(), network.high.tolist(), strict=True), strict=True))
    baselines = baseline_models(fit.values[:, :count], fit.values[:, count:])
    urdf = urdf_kinematics(dataset)
    if urdf is not None:
        baselines["URDF kinematics"] = urdf
    maps = tuple(
        EvaluatedOutput(
            predict=lambda q, number=number: network.predict(q)[:, number],  # type: ignore[misc]
            baselines={title: lambda q, each=each, number=number: each(q)[:, number] for title, each in baselines.items()},  # type: ignore[misc]
            uncertainty=network.uncertainty,
            sources=tuple(range(count)),
            target=count + number,
            ends=_joint_limits(dataset, fitted),
            fitted=fitted,
            spread=lambda q, number=number: network.spread(q)[:, number],  # type: ignore[misc]
            number=number,
        )
        for number in range(3)
    )
    rows_by_kind = _rows_by_kind(dataset, role, signals, ("poses", "motion"))
    outputs = [output_report(dataset, rows, kind, item) for kind, rows in rows_by_kind.items() for item in maps]
    return ValidationReport("forward", name, dataset.reference, role, tuple(outputs))


def _joint_limits(dataset: Dataset, fitted: Ranges) -> Ranges:
    """Limits of every joint, or the fitted range where the machine's description has none."""
    limits = {axis_signal(axis.name, "joint"): axis.limits for axis in dataset.machine.axes}
    return {signal: ends if ends is not None and np.isfinite(ends).all() else fitted[signal] for signal, ends in limits.items()}


def _rows_by_kind(dataset: Dataset, role: Role, signals: tuple[str, ...], kinds: tuple[Kind, ...]) -> dict[Kind, SignalRows]:
    """Rows of ``role`` by kind of recording.

    Raises:
        ExcitationError: there are none at all.
    """
    found: dict[Kind, SignalRows] = {}
    for kind in kinds:
        if measures(dataset, signals, kind):
            rows = gather(segments(dataset, role, signals, kind), signals)
            if len(rows):
                found[kind] = rows
    if not found:
        raise ExcitationError(
            f"dataset {dataset.reference}",
            f"no {role} rows that measure {', '.join(signals)} at the same time",
            "at least one",
            "Record more, or name other recordings in [splits] of the recipe.",
        )
    return found
