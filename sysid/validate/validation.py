"""Judge networks on recordings that had no part in fitting them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
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
from sysid.networks.trust import FALSE_FLAGS, Trust
from sysid.plant import gravity_load
from sysid.signals import axis_signal, point_signals
from sysid.validate.baselines import Predict, linkage_geometry, simple_models, urdf_kinematics
from sysid.validate.binning import per_second
from sysid.validate.coverage import LEVEL, Coverage, coverage_of
from sysid.validate.error_analysis import Profile, Ranges, direction_profile, profile, speeds, spikes
from sysid.validate.error_maps import Axis, ErrorMap, error_maps
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
        maps = tuple(
            JudgedMap(
                predict=lambda x, predict=predict: predict(x[:, 0]),  # type: ignore[misc]
                simple=simple_models(fit.values[:, [source]], fit.values[:, target])
                | {"linkage geometry": linkage_geometry(fit.values[:, 0], fit.values[:, 1], target == 1)},
                trust=network.trust.get(direction),
                sources=(source,),
                target=target,
                ends={signals[0]: axis_ends(dataset, axis, network)},
                fitted={signals[source]: (network.displacements, network.joints)[source]},
            )
            for direction, source, target, predict in (
                ("to_joint", 0, 1, network.joint),
                ("to_cylinder", 1, 0, network.displacement),
            )
        )
        outputs += [output_report(dataset, rows, kind, item) for kind, rows in judged.items() for item in maps]
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
    simple = simple_models(fit.values[:, :count], fit.values[:, count:])
    urdf = urdf_kinematics(dataset)
    if urdf is not None:
        simple["URDF kinematics"] = urdf
    maps = tuple(
        JudgedMap(
            predict=lambda q, number=number: network.predict(q)[:, number],  # type: ignore[misc]
            simple={title: lambda q, each=each, number=number: each(q)[:, number] for title, each in simple.items()},  # type: ignore[misc]
            trust=network.trust,
            sources=tuple(range(count)),
            target=count + number,
            ends=_joint_limits(dataset, fitted),
            fitted=fitted,
            spread=lambda q, number=number: network.spread(q)[:, number],  # type: ignore[misc]
            number=number,
        )
        for number in range(3)
    )
    judged = _judged(dataset, role, signals, ("poses", "motion"))
    outputs = [output_report(dataset, rows, kind, item) for kind, rows in judged.items() for item in maps]
    return ValidationReport("forward", name, dataset.reference, role, tuple(outputs))


@dataclass(frozen=True)
class JudgedMap:
    """One output of a network to judge.

    Args:
        predict: inputs (n, d) → output (n,); ``simple``: baselines of the same kind, by name.
        trust: of the network; None for a version that has none.
        sources, target: columns of the rows.
        ends: signals whose ends can explain a spike; ``fitted``: inputs and the ranges that were learned.
        spread: of the members, where there are several; ``number``: of this output among those of the network.
    """

    predict: Predict
    simple: Mapping[str, Predict]
    trust: Trust | None
    sources: tuple[int, ...]
    target: int
    ends: Ranges
    fitted: Ranges
    spread: Predict | None = None
    number: int = 0


def output_report(dataset: Dataset, rows: Rows, kind: Kind, item: JudgedMap, along: Array | None = None) -> OutputReport:
    """``along``: what a network with a memory said at ``rows``; its map is what it says without one."""
    inputs, truth, output = rows.values[:, list(item.sources)], rows.values[:, item.target], rows.signals[item.target]
    unit, predicted = _unit(dataset, output), item.predict(inputs) if along is None else along
    errors = predicted - truth
    profiles, maps = _where(dataset, rows, errors, item.sources, kind)
    shown = np.linspace(0, len(rows) - 1, min(len(rows), TRACE_ROWS)).round().astype(np.int64)
    trace = Trace(
        recording=rows.recording[shown],
        time=rows.time[shown],
        truth=truth[shown],
        predicted=predicted[shown],
        inputs={rows.signals[source]: rows.values[shown, source] for source in item.sources},
    )
    return OutputReport(
        output=output,
        inputs=tuple(rows.signals[source] for source in item.sources),
        rows=kind,
        recordings=tuple(dict.fromkeys(str(name) for name in rows.recording)),
        metrics=error_metrics(truth, predicted, unit),
        baselines={title: error_metrics(truth, predict(inputs), unit) for title, predict in item.simple.items()},
        # A static pose is the mean of many samples: the noise of one sample says nothing about it.
        noise_floor=_noise_floor(dataset, rows, item) if kind == "motion" else None,
        profiles=profiles,
        spikes=spikes(dataset, rows, errors, item.ends, item.fitted, kind == "motion"),
        trace=trace,
        maps=maps,
        coverage=_coverage(rows, inputs, truth, predicted, item),
    )


def _where(
    dataset: Dataset, rows: Rows, errors: Array, sources: tuple[int, ...], kind: Kind
) -> tuple[tuple[Profile, ...], tuple[ErrorMap, ...]]:
    """Errors against each input, its speed and direction, and the loads; and against two of them at a time."""
    profiles: list[Profile] = []
    axes: list[Axis] = []
    moving: list[tuple[str, str]] = []
    for source in sources:
        signal = rows.signals[source]
        unit = _unit(dataset, signal)
        values = rows.values[:, source]
        profiles.append(profile(errors, values, signal, unit))
        axes.append(Axis(signal, unit, values))
        speed = speeds(dataset, rows, signal) if kind == "motion" else np.full(len(rows), np.nan)
        if np.isfinite(speed).any():
            profiles.append(profile(errors, np.abs(speed), f"speed of {signal}", per_second(unit)))
            profiles.append(direction_profile(errors, speed, f"direction of {signal}", per_second(unit)))
            axes.append(Axis(f"speed of {signal}", per_second(unit), speed, "signed"))
            moving.append((signal, axes[-1].name))
    for signal, (load_unit, load) in _loads(dataset, rows).items():
        profiles.append(profile(errors, load, f"load of {signal}", load_unit))
    inputs = [rows.signals[source] for source in sources]
    return tuple(profiles), error_maps(errors, axes, [*combinations(inputs, 2), *moving])


def _loads(dataset: Dataset, rows: Rows) -> dict[str, tuple[str, Array]]:
    """Joint → unit and gravity load at every row, for those joints that ``rows`` are about and that carry any."""
    if dataset.machine.kinematics() is None:
        return {}
    found: dict[str, tuple[str, Array]] = {}
    parts = {str(name): gravity_load(dataset.machine, dataset.recording(str(name))) for name in np.unique(rows.recording)}
    for column, axis in enumerate(dataset.machine.axis_names):
        signal = axis_signal(axis, "joint")
        if signal not in rows.signals:
            continue
        load = np.empty(len(rows))
        for name, values in parts.items():
            mine = rows.recording == name
            load[mine] = values[rows.row[mine], column]
        if np.ptp(load) > 0.0:
            found[signal] = ("N·m" if is_angle(dataset, signal) else "N", load)
    return found


def _coverage(rows: Rows, inputs: Array, truth: Array, predicted: Array, item: JudgedMap) -> Coverage | None:
    trust = item.trust
    if trust is None:
        return None
    spread = np.zeros((len(rows), len(trust.intervals.floor)))
    if item.spread is not None:
        spread[:, item.number] = item.spread(inputs)
    level = min(LEVEL, trust.intervals.most_level)
    reach = trust.intervals.reach(spread, level)[:, item.number]
    names = [rows.signals[source] for source in item.sources]
    inside = trust.domain.inside(inputs)
    return coverage_of(truth, (predicted - reach, predicted + reach), inside, inputs, names, FALSE_FLAGS, level)


def _noise_floor(dataset: Dataset, rows: Rows, item: JudgedMap) -> float | None:
    """√(σ_out² + Σ (∂f/∂x · σ_in)²), the slopes taken from the network itself; None where a σ is not stated."""
    noise, sources = dataset.machine.noise, item.sources
    if any(rows.signals[column] not in noise for column in (*sources, item.target)):
        return None
    inputs = thin(rows, SLOPE_ROWS).values[:, list(sources)]
    variance = np.full(len(inputs), noise[rows.signals[item.target]] ** 2)
    for position, source in enumerate(sources):
        step = np.zeros(len(sources))
        # Wide enough to average over the kinks of a ReLU network.
        step[position] = 0.01 * max(float(np.ptp(rows.values[:, source])), 1e-9)
        slope = (item.predict(inputs + step) - item.predict(inputs - step)) / (2.0 * step[position])
        variance += (slope * noise[rows.signals[source]]) ** 2
    return float(np.sqrt(variance.mean()))


def axis_ends(dataset: Dataset, axis: str, network: ActuatorNetwork) -> tuple[float, float]:
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
