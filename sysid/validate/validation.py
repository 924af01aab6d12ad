"""Evaluation of networks on held-out recordings; of those with a state (actuators with history, and command → motion) by free
runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Kind, Recording
from sysid.errors import ExcitationError
from sysid.networks.actuator import DIRECTIONS, ActuatorNetwork, RoundTripError, actuator_rows
from sysid.networks.artifacts import Model, history_networks, motion_networks, static_networks
from sysid.networks.forward import ForwardModel, ForwardNetwork, forward_rows
from sysid.networks.history import HistoryNetwork
from sysid.networks.motion import START_INTERVAL_S, MotionNetwork, motion_rows, motions, window_for
from sysid.networks.motion_inputs import Index, MotionStretch, Speed, Window, horizon_errors, whole_run
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.split import SignalRows, gather, measures, segments
from sysid.networks.structured import StructuredForward
from sysid.plant import free_run, nominal_plant
from sysid.signals import axis_signal, point_signals
from sysid.validate.baselines import baseline_models, urdf_kinematics
from sysid.validate.error_analysis import Ranges, profile, speed_profiles, speeds, spikes
from sysid.validate.metrics import error_metrics
from sysid.validate.output_reports import EvaluatedOutput, actuator_output, output_report
from sysid.validate.report import OutputReport, ValidationReport

Array = npt.NDArray[np.float64]

#: Names of the baselines.
STATIC, PLANT, ARX = "static network", "nominal simulation", "linear ARX"


def validate_history(
    networks: Mapping[str, HistoryNetwork],
    dataset: Dataset,
    recipe: NetworkRecipe | None = None,
    name: str = "",
) -> ValidationReport:
    """Both directions of every axis along the held-out motion, with their static parts and other baselines.

    Raises:
        ExcitationError: no held-out rows have both signals of an axis.
    """
    outputs, round_trips = [], dict[str, RoundTripError]()
    for axis, network in networks.items():
        signals = (axis_signal(axis, "cylinder"), axis_signal(axis, "joint"))
        fit, _ = actuator_rows(dataset, axis, recipe or NetworkRecipe())
        parts = segments(dataset, "held_out", signals)
        rows = gather(parts, signals)
        if not len(rows):
            found = f"no held_out rows that measure {' and '.join(signals)} at the same time"
            raise ExcitationError(f"dataset {dataset.reference}", found, "at least one")
        for direction, along in zip(DIRECTIONS, (network.joint_along, network.displacement_along), strict=True):
            item = actuator_output(dataset, network.static, direction, fit)
            predicted = []
            for part in parts:
                values = part.recording.values(signals[item.sources[0]])[part.start : part.stop]
                mine = rows.recording == part.recording.name
                predicted.append(along(values, part.recording.rate_hz)[rows.row[mine] - part.start])
            item = replace(item, uncertainty=None, baselines={**item.baselines, STATIC: item.predict})
            outputs.append(output_report(dataset, rows, "motion", item, np.concatenate(predicted)))
        longest = max(parts, key=lambda part: part.stop - part.start)
        cylinder, joint = (longest.recording.values(signal)[longest.start : longest.stop] for signal in signals)
        round_trips[axis] = network.round_trip(cylinder, joint, longest.recording.rate_hz)
    return ValidationReport("history", name, dataset.reference, tuple(outputs), round_trips)


@dataclass(frozen=True)
class _Runs:
    """Free runs of one model, per part of a recording: evaluated rows, rows of their starts, and predictions."""

    rows: list[Index]
    begins: list[Index]
    predicted: list[Array]


def validate_motion(
    networks: Mapping[str, MotionNetwork],
    dataset: Dataset,
    recipe: NetworkRecipe | None = None,
    name: str = "",
) -> ValidationReport:
    """Free runs of every axis on held-out recordings: to horizons, from starts all along them, and of whole recordings.

    Baselines on the same rows: the nominal simulation of ``machine.toml``, a free run of the whole recording (its error at the
    start is subtracted for axes whose command is a speed or a force), and a linear least-squares model of the same inputs.

    Raises:
        ExcitationError: no held-out recording is long enough.
    """
    settings = (recipe or NetworkRecipe()).motion
    plant = nominal_plant(dataset.machine, streams=dataset.streams)
    simulated: dict[str, Mapping[str, Array]] = {}
    outputs = []
    for axis, network in networks.items():
        about = dataset.machine.axis(axis)
        parts = motions(dataset, about, network.window, "held_out")
        for recording, _ in parts:
            if recording.name not in simulated:
                table = free_run(plant, recording)
                simulated[recording.name] = {str(column): table[column].to_numpy() for column in table.columns}
        window = window_for(about, settings, dataset.machine.rate_hz)
        linear = _linear(*motion_rows(dataset, about, window, "fit", settings.samples))
        for horizon in (*settings.horizons, None):
            runs = _runs(network, network.speed, network.window, parts, horizon)
            baselines = {ARX: _runs(network, linear, window, parts, horizon)}
            nominal = _simulated(simulated, network.driven, about.actuation == "position", parts, runs)
            entry = _motion_report(dataset, network, parts, horizon, runs, baselines, nominal)
            outputs += [entry] if entry is not None else []
    if not outputs:
        found = "no held_out motion as long as the history of a network"
        raise ExcitationError(f"dataset {dataset.reference}", found, "at least one free run", "Record longer motions.")
    return ValidationReport("motion", name, dataset.reference, tuple(outputs))


def output_name(driven: str, horizon: float | None) -> str:
    """``boom.cylinder after 500 ms``, or ``boom.cylinder whole run``."""
    return f"{driven} whole run" if horizon is None else f"{driven} after {1e3 * horizon:.0f} ms"


def _linear(x: Array, y: Array) -> Speed:
    """Linear model of the same inputs, by least squares."""
    weights = np.linalg.lstsq(np.column_stack([x, np.ones(len(x))]), y[:, 0], rcond=None)[0]
    return lambda inputs: np.asarray(inputs @ weights[:-1] + weights[-1])


def _runs(
    network: MotionNetwork,
    speed: Speed,
    window: Window,
    parts: tuple[tuple[Recording, MotionStretch], ...],
    horizon: float | None,
) -> _Runs:
    """Free runs of a model within the network's bounds."""
    found = [motion for _, motion in parts]
    if horizon is not None:
        ends = horizon_errors(speed, window, network.bounds, found, horizon, START_INTERVAL_S)
        back = max(1, round(horizon / window.step))
        begins = [rows - back * motion.stride for (rows, _, _), motion in zip(ends, found, strict=True)]
        return _Runs([rows for rows, _, _ in ends], begins, [predicted for _, predicted, _ in ends])
    rows, begins, predicted = [], [], []
    for motion in found:
        run = whole_run(speed, window, network.bounds, motion)
        here = np.flatnonzero(np.isfinite(run) & np.isfinite(motion.position))
        first = np.flatnonzero(np.isfinite(run) & ~np.r_[False, np.isfinite(run[:-1])])
        rows.append(here)
        begins.append(first[np.searchsorted(first, here, side="right") - 1])
        predicted.append(run[here])
    return _Runs(rows, begins, predicted)


def _simulated(
    simulated: Mapping[str, Mapping[str, Array]],
    driven: str,
    is_position: bool,
    parts: tuple[tuple[Recording, MotionStretch], ...],
    runs: _Runs,
) -> list[Array]:
    """Prediction of the nominal simulation at the same rows, (b,) per part; NaN where it has none."""
    found = []
    for (recording, motion), rows, begins in zip(parts, runs.rows, runs.begins, strict=True):
        run = simulated[recording.name].get(driven)
        if run is None:
            found.append(np.full(len(rows), np.nan))
            continue
        off = 0.0 if is_position else run[begins] - motion.position[begins]
        found.append(run[rows] - off)
    return found


def _motion_report(
    dataset: Dataset,
    network: MotionNetwork,
    parts: tuple[tuple[Recording, MotionStretch], ...],
    horizon: float | None,
    runs: _Runs,
    others: Mapping[str, _Runs],
    simulated: list[Array],
) -> OutputReport | None:
    """Report over the rows that the network and every baseline predict; None where there are none."""
    rows = _rows(network, parts, runs)
    predicted, truth = np.concatenate(runs.predicted), rows.values[:, 1]
    baselines = {title: np.concatenate(list(_at(runs.rows, other))) for title, other in others.items()}
    baselines[PLANT] = np.concatenate(simulated)
    baselines = {title: values for title, values in baselines.items() if np.isfinite(values).any()}
    common = np.all([np.isfinite(values) for values in (predicted, truth, *baselines.values())], axis=0)
    if not common.any():
        return None
    chosen = np.flatnonzero(common)
    rows, predicted, truth = rows.take(chosen), predicted[common], truth[common]
    errors, unit = predicted - truth, network.unit
    sigma = dataset.machine.noise.get(network.driven)
    speed = speeds(dataset, rows, network.driven)
    profiles = [profile(errors, rows.values[:, 0], network.command, "1")]
    if np.isfinite(speed).any():
        profiles += speed_profiles(errors, speed, network.command, f"{unit}/s")
    return OutputReport(
        output=output_name(network.driven, horizon),
        inputs=(network.command,),
        rows="motion",
        recordings=tuple(dict.fromkeys(map(str, rows.recording))),
        metrics=error_metrics(truth, predicted, unit),
        baselines={title: error_metrics(truth, values[common], unit) for title, values in baselines.items()},
        # Both the start of a run and the position at its end are measured.
        noise_floor=None if sigma is None else float(np.sqrt(2.0) * sigma),
        profiles=tuple(profiles),
        spikes=spikes(dataset, rows, errors, {}, {network.command: network.commands}, True),
    )


def _rows(network: MotionNetwork, parts: tuple[tuple[Recording, MotionStretch], ...], runs: _Runs) -> SignalRows:
    """Command and position at the evaluated rows."""
    signals = (network.command, network.driven)
    columns = [
        (
            np.column_stack([recording.values(signal)[rows] for signal in signals]),
            np.full(len(rows), recording.name),
            rows,
            recording.values("time")[rows],
        )
        for (recording, _), rows in zip(parts, runs.rows, strict=True)
    ]
    values, names, at, times = (np.concatenate(column) for column in zip(*columns, strict=True))
    return SignalRows(signals, values, names, at, times)


def _at(rows: list[Index], other: _Runs) -> Iterator[Array]:
    """Prediction of another model at ``rows``; NaN where it has none."""
    for wanted, present, predicted in zip(rows, other.rows, other.predicted, strict=True):
        found: Array = np.full(len(wanted), np.nan, dtype=np.float64)
        _, at, of = np.intersect1d(wanted, present, assume_unique=True, return_indices=True)
        found[at] = predicted[of]
        yield found


def validate_model(model: Model, dataset: Dataset, recipe: NetworkRecipe | None = None, name: str = "") -> ValidationReport:
    """Report of a model of any kind, by the function for its kind."""
    if isinstance(model, ForwardNetwork | StructuredForward):
        return validate_forward(model, dataset, name)
    if motions := motion_networks(model):
        return validate_motion(motions, dataset, recipe, name)
    if histories := history_networks(model):
        return validate_history(histories, dataset, recipe, name)
    return validate_actuator(static_networks(model), dataset, recipe, name)


def validate_actuator(
    networks: Mapping[str, ActuatorNetwork],
    dataset: Dataset,
    recipe: NetworkRecipe | None = None,
    name: str = "",
) -> ValidationReport:
    """Both directions of every axis on all held-out rows: in motion, and at static poses that measure the cylinder.

    Args:
        networks: axis → network, from ``fit_actuator``.
        recipe: of the fit, so that the baselines are fitted on the same rows; default: the paper's.
        name: of the model, for the report.

    Raises:
        ExcitationError: no held-out rows have both signals of an axis.
    """
    outputs = []
    for axis, network in networks.items():
        signals = (axis_signal(axis, "cylinder"), axis_signal(axis, "joint"))
        fit, _ = actuator_rows(dataset, axis, recipe or NetworkRecipe())
        rows_by_kind = _rows_by_kind(dataset, signals, ("motion", "poses"))
        maps = [actuator_output(dataset, network, direction, fit) for direction in DIRECTIONS]
        outputs += [output_report(dataset, rows, kind, item) for kind, rows in rows_by_kind.items() for item in maps]
    round_trips = {axis: network.round_trip() for axis, network in networks.items()}
    return ValidationReport("actuator", name, dataset.reference, tuple(outputs), round_trips)


def validate_forward(network: ForwardModel, dataset: Dataset, name: str = "") -> ValidationReport:
    """End effector on the held-out static poses, and on held-out motion if it was measured.

    Raises:
        ExcitationError: neither held-out poses nor held-out motion have all joints and the end effector.
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
    rows_by_kind = _rows_by_kind(dataset, signals, ("poses", "motion"))
    outputs = [output_report(dataset, rows, kind, item) for kind, rows in rows_by_kind.items() for item in maps]
    return ValidationReport("forward", name, dataset.reference, tuple(outputs))


def _joint_limits(dataset: Dataset, fitted: Ranges) -> Ranges:
    """Limits of every joint, or the fitted range where the machine's description has none."""
    limits = {axis_signal(axis.name, "joint"): axis.limits for axis in dataset.machine.axes}
    return {signal: ends if ends is not None and np.isfinite(ends).all() else fitted[signal] for signal, ends in limits.items()}


def _rows_by_kind(dataset: Dataset, signals: tuple[str, ...], kinds: tuple[Kind, ...]) -> dict[Kind, SignalRows]:
    """Held-out rows by kind of recording.

    Raises:
        ExcitationError: there are none at all.
    """
    found: dict[Kind, SignalRows] = {}
    for kind in kinds:
        if measures(dataset, signals, kind):
            rows = gather(segments(dataset, "held_out", signals, kind), signals)
            if len(rows):
                found[kind] = rows
    if not found:
        raise ExcitationError(
            f"dataset {dataset.reference}",
            f"no held_out rows that measure {', '.join(signals)} at the same time",
            "at least one",
            "Record more, or name other recordings in [splits] of the recipe.",
        )
    return found
