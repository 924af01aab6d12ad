"""Evaluation of one output of a network: errors, baselines, noise floor, profiles, maps, spikes, coverage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Kind
from sysid.networks.actuator import ActuatorNetwork
from sysid.networks.forward import is_angle
from sysid.networks.split import SignalRows, thin
from sysid.networks.uncertainty import FALSE_FLAGS, NetworkUncertainty
from sysid.plant import gravity_load
from sysid.signals import axis_signal
from sysid.validate.baselines import Predict, baseline_models, linkage_geometry
from sysid.validate.error_analysis import (
    ErrorMap,
    MapAxis,
    Profile,
    Ranges,
    error_maps,
    per_second,
    profile,
    speed_profiles,
    speeds,
    spikes,
)
from sysid.validate.metrics import LEVEL, Coverage, coverage_of, error_metrics
from sysid.validate.report import OutputReport

Array = npt.NDArray[np.float64]

#: Largest number of rows at which the slopes for the noise floor are computed.
SLOPE_ROWS = 500


@dataclass(frozen=True)
class EvaluatedOutput:
    """One output of a network to evaluate.

    Args:
        predict: inputs (n, d) → output (n,); ``baselines``: of the same kind, by name.
        uncertainty: of the network; None for a version without.
        sources, target: columns of the rows.
        ends: signals whose ends are possible causes of a spike; ``fitted``: inputs and their fitted ranges.
        spread: of the ensemble; ``number``: index of this output in the network.
    """

    predict: Predict
    baselines: Mapping[str, Predict]
    uncertainty: NetworkUncertainty | None
    sources: tuple[int, ...]
    target: int
    ends: Ranges
    fitted: Ranges
    spread: Predict | None = None
    number: int = 0


def actuator_output(dataset: Dataset, network: ActuatorNetwork, direction: str, fit: SignalRows) -> EvaluatedOutput:
    """One direction of a static actuator network, with baselines fitted on ``fit``, rows of (cylinder, joint)."""
    source, target = (0, 1) if direction == "to_joint" else (1, 0)
    predict = (network.joint, network.displacement)[source]
    return EvaluatedOutput(
        predict=lambda x: predict(x[:, 0]),
        baselines=baseline_models(fit.values[:, [source]], fit.values[:, target])
        | {"linkage geometry": linkage_geometry(fit.values[:, 0], fit.values[:, 1], target == 1)},
        uncertainty=network.uncertainty.get(direction),
        sources=(source,),
        target=target,
        # End stops of the cylinder, or the fitted range where the machine's description has none.
        ends={fit.signals[0]: dataset.machine.axis(network.axis).stroke or network.displacements},
        fitted={fit.signals[source]: (network.displacements, network.joints)[source]},
    )


def output_report(
    dataset: Dataset, rows: SignalRows, kind: Kind, item: EvaluatedOutput, stateful: Array | None = None
) -> OutputReport:
    """Report of one output; ``stateful``: predictions of a network with a state at ``rows``, in place of ``item.predict``."""
    inputs, truth, output = rows.values[:, list(item.sources)], rows.values[:, item.target], rows.signals[item.target]
    unit, predicted = _unit(dataset, output), item.predict(inputs) if stateful is None else stateful
    errors = predicted - truth
    profiles, maps = _profiles_and_maps(dataset, rows, errors, item.sources, kind)
    return OutputReport(
        output=output,
        inputs=tuple(rows.signals[source] for source in item.sources),
        rows=kind,
        recordings=tuple(dict.fromkeys(str(name) for name in rows.recording)),
        metrics=error_metrics(truth, predicted, unit),
        baselines={title: error_metrics(truth, predict(inputs), unit) for title, predict in item.baselines.items()},
        # A static pose is the mean of many samples, so the noise of one sample does not apply.
        noise_floor=_noise_floor(dataset, rows, item) if kind == "motion" else None,
        profiles=profiles,
        spikes=spikes(dataset, rows, errors, item.ends, item.fitted, kind == "motion"),
        maps=maps,
        coverage=_coverage(rows, inputs, truth, predicted, item),
    )


def _profiles_and_maps(
    dataset: Dataset, rows: SignalRows, errors: Array, sources: tuple[int, ...], kind: Kind
) -> tuple[tuple[Profile, ...], tuple[ErrorMap, ...]]:
    """Profiles against each input, its speed and direction, and the loads; maps over two of them."""
    profiles: list[Profile] = []
    inputs: list[MapAxis] = []
    moving: list[tuple[MapAxis, MapAxis]] = []
    for source in sources:
        signal = rows.signals[source]
        unit = _unit(dataset, signal)
        values = rows.values[:, source]
        profiles.append(profile(errors, values, signal, unit))
        inputs.append(MapAxis(signal, unit, values))
        speed = speeds(dataset, rows, signal) if kind == "motion" else np.full(len(rows), np.nan)
        if np.isfinite(speed).any():
            profiles += speed_profiles(errors, speed, signal, per_second(unit))
            moving.append((inputs[-1], MapAxis(f"speed of {signal}", per_second(unit), speed, "signed")))
    for signal, (load_unit, load) in _loads(dataset, rows).items():
        profiles.append(profile(errors, load, f"load of {signal}", load_unit))
    return tuple(profiles), error_maps(errors, [*combinations(inputs, 2), *moving])


def _loads(dataset: Dataset, rows: SignalRows) -> dict[str, tuple[str, Array]]:
    """Joint → unit and gravity load at every row, for joints of ``rows`` whose load varies."""
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


def _coverage(rows: SignalRows, inputs: Array, truth: Array, predicted: Array, item: EvaluatedOutput) -> Coverage | None:
    uncertainty = item.uncertainty
    if uncertainty is None:
        return None
    spread = np.zeros((len(rows), len(uncertainty.intervals.floor)))
    if item.spread is not None:
        spread[:, item.number] = item.spread(inputs)
    level = min(LEVEL, uncertainty.intervals.max_level)
    reach = uncertainty.intervals.reach(spread, level)[:, item.number]
    names = [rows.signals[source] for source in item.sources]
    inside = uncertainty.domain.inside(inputs)
    return coverage_of(truth, (predicted - reach, predicted + reach), inside, inputs, names, FALSE_FLAGS, level)


def _noise_floor(dataset: Dataset, rows: SignalRows, item: EvaluatedOutput) -> float | None:
    """√(σ_out² + Σ (∂f/∂x · σ_in)²) with the slopes of the network; None where a σ is not stated."""
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


def _unit(dataset: Dataset, signal: str) -> Literal["m", "rad"]:
    if signal.endswith(".joint"):
        return "rad" if is_angle(dataset, signal) else "m"
    return "m"
