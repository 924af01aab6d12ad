"""Judge networks on recordings that had no part in fitting them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Kind, Role
from sysid.errors import ExcitationError
from sysid.networks.actuator import ActuatorNetwork, actuator_rows
from sysid.networks.artifacts import Model, history_networks, motion_networks, static_networks
from sysid.networks.forward import ForwardModel, ForwardNetwork, forward_rows, is_angle
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.split import Rows, gather, measures, segments, thin
from sysid.networks.structured import StructuredForward
from sysid.signals import axis_signal, point_signals
from sysid.validate.baselines import learned, urdf_kinematics
from sysid.validate.error_analysis import Profile, Ranges, direction_profile, profile, speeds, spikes
from sysid.validate.metrics import error_metrics
from sysid.validate.report import OutputReport, Trace, ValidationReport

Array = npt.NDArray[np.float64]

#: Rows kept for plots.
TRACE_ROWS = 2000
#: Rows that the slopes for the noise floor are taken at.
SLOPE_ROWS = 500


def validate_model(
    model: Model, dataset: Dataset, role: Role = "held_out", recipe: NetworkRecipe | None = None, name: str = ""
) -> ValidationReport:
    """:func:`validate_actuator`, :func:`validate_forward`, or one of those for networks that run along a motion."""
    from sysid.validate.along import validate_history, validate_motion  # which build on this

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
        role: recordings to judge on.
        recipe: that of the fit, so that the baselines learn from the same rows; default: the paper's.
        name: of the model, for the report.

    Raises:
        ExcitationError: no rows of that role have both signals of an axis.
    """
    outputs = []
    for axis, network in networks.items():
        signals = (axis_signal(axis, "cylinder"), axis_signal(axis, "joint"))
        fit, _ = actuator_rows(dataset, axis, recipe or NetworkRecipe())
        judged = _judged(dataset, role, signals, ("motion", "poses"))
        for kind, rows in judged.items():
            for source, target, predict in ((0, 1, network.joint), (1, 0, network.displacement)):
                inputs = rows.values[:, [source]]
                baselines = learned(fit.values[:, [source]], fit.values[:, target], inputs)
                outputs.append(
                    _output_report(
                        dataset,
                        rows,
                        target,
                        (source,),
                        kind,
                        predict(inputs[:, 0]),
                        baselines,
                        _noise_floor(dataset, rows, (source,), target, lambda x, predict=predict: predict(x[:, 0])),  # type: ignore[misc]
                        ends={signals[0]: _ends(dataset, axis, network)},
                        fitted={signals[source]: (network.displacements, network.joints)[source]},
                    )
                )
    round_trips = {axis: network.round_trip() for axis, network in networks.items()}
    return ValidationReport("actuator", name, dataset.reference, role, tuple(outputs), round_trips)


def validate_forward(network: ForwardModel, dataset: Dataset, role: Role = "held_out", name: str = "") -> ValidationReport:
    """End effector on the static poses of ``role``, and on its motion where that was measured as well.

    Raises:
        ExcitationError: neither poses nor motion of that role have all joints and the end effector.
    """
    signals = (*network.joints, *point_signals("ee"))
    count = len(network.joints)
    fit = forward_rows(dataset, "fit")
    fitted = dict(zip(network.joints, zip(network.low.tolist(), network.high.tolist(), strict=True), strict=True))
    outputs = []
    for kind, rows in _judged(dataset, role, signals, ("poses", "motion")).items():
        predicted = network.predict(rows.values[:, :count])
        baselines = learned(fit.values[:, :count], fit.values[:, count:], rows.values[:, :count])
        urdf = urdf_kinematics(dataset, rows, count)
        if urdf is not None:
            baselines["URDF kinematics"] = urdf
        for number in range(3):
            outputs.append(
                _output_report(
                    dataset,
                    rows,
                    count + number,
                    tuple(range(count)),
                    kind,
                    predicted[:, number],
                    {title: values[:, number] for title, values in baselines.items()},
                    _noise_floor(
                        dataset,
                        rows,
                        tuple(range(count)),
                        count + number,
                        lambda q, number=number: network.predict(q)[:, number],  # type: ignore[misc]
                    ),
                    ends=_joint_limits(dataset, fitted),
                    fitted=fitted,
                )
            )
    return ValidationReport("forward", name, dataset.reference, role, tuple(outputs))


def _output_report(
    dataset: Dataset,
    rows: Rows,
    target: int,
    sources: tuple[int, ...],
    kind: Kind,
    predicted: Array,
    baselines: Mapping[str, Array],
    noise_floor: float | None,
    ends: Ranges,
    fitted: Ranges,
) -> OutputReport:
    truth, output = rows.values[:, target], rows.signals[target]
    unit = _unit(dataset, output)
    errors = predicted - truth
    profiles: list[Profile] = []
    for source in sources:
        signal = rows.signals[source]
        signal_unit = _unit(dataset, signal)
        profiles.append(profile(errors, rows.values[:, source], signal, signal_unit))
        if kind == "motion":
            speed = speeds(dataset, rows, signal)
            if np.isfinite(speed).any():
                profiles.append(profile(errors, np.abs(speed), f"speed of {signal}", f"{signal_unit}/s"))
                profiles.append(direction_profile(errors, speed, f"direction of {signal}", f"{signal_unit}/s"))
    shown = np.linspace(0, len(rows) - 1, min(len(rows), TRACE_ROWS)).round().astype(np.int64)
    trace = Trace(
        recording=rows.recording[shown],
        time=rows.time[shown],
        truth=truth[shown],
        predicted=predicted[shown],
        inputs={rows.signals[source]: rows.values[shown, source] for source in sources},
    )
    return OutputReport(
        output=output,
        inputs=tuple(rows.signals[source] for source in sources),
        rows=kind,
        recordings=tuple(dict.fromkeys(str(name) for name in rows.recording)),
        metrics=error_metrics(truth, predicted, unit),
        baselines={title: error_metrics(truth, values, unit) for title, values in baselines.items()},
        # A static pose is the mean of many samples: the noise of one sample says nothing about it.
        noise_floor=noise_floor if kind == "motion" else None,
        profiles=tuple(profiles),
        spikes=spikes(dataset, rows, errors, ends, fitted, kind == "motion"),
        trace=trace,
    )


def _noise_floor(
    dataset: Dataset, rows: Rows, sources: tuple[int, ...], target: int, predict: Callable[[Array], Array]
) -> float | None:
    """√(σ_out² + Σ (∂f/∂x · σ_in)²), the slopes taken from the network itself; None where a σ is not stated."""
    noise = dataset.machine.noise
    if any(rows.signals[column] not in noise for column in (*sources, target)):
        return None
    inputs = thin(rows, SLOPE_ROWS).values[:, list(sources)]
    variance = np.full(len(inputs), noise[rows.signals[target]] ** 2)
    for position, source in enumerate(sources):
        step = np.zeros(len(sources))
        # Wide enough to average over the kinks of a ReLU network.
        step[position] = 0.01 * max(float(np.ptp(rows.values[:, source])), 1e-9)
        slope = (predict(inputs + step) - predict(inputs - step)) / (2.0 * step[position])
        variance += (slope * noise[rows.signals[source]]) ** 2
    return float(np.sqrt(variance.mean()))


def _ends(dataset: Dataset, axis: str, network: ActuatorNetwork) -> tuple[float, float]:
    """End stops of the cylinder, or what was fitted where the machine's description gives none."""
    return dataset.machine.axis(axis).stroke or network.displacements


def _joint_limits(dataset: Dataset, fitted: Ranges) -> Ranges:
    """Limits of every joint, or the range that was fitted where the machine's description gives none."""
    limits = {axis_signal(axis.name, "joint"): axis.limits for axis in dataset.machine.axes}
    return {signal: ends if ends is not None and np.isfinite(ends).all() else fitted[signal] for signal, ends in limits.items()}


def _unit(dataset: Dataset, signal: str) -> Literal["m", "rad"]:
    if signal.endswith(".joint"):
        return "rad" if is_angle(dataset, signal) else "m"
    return "m"


def _judged(dataset: Dataset, role: Role, signals: tuple[str, ...], kinds: tuple[Kind, ...]) -> dict[Kind, Rows]:
    """Rows of ``role`` by kind of recording.

    Raises:
        ExcitationError: there are none at all.
    """
    found: dict[Kind, Rows] = {}
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
