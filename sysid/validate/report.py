"""Validation reports as frozen values, and whether a network or a simple model is the better choice, from their errors on the
same held-out rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from sysid.datasets.recording import Kind
from sysid.files import plain
from sysid.names import listed
from sysid.networks.actuator import RoundTripError
from sysid.validate.error_analysis import ErrorMap, Profile, Spike
from sysid.validate.metrics import Coverage, ErrorMetrics

#: Errors that differ by less are alike; the promotion policy permits the same.
ALIKE = 1.05


def recommendation(errors: Mapping[str, tuple[float, Mapping[str, float]]]) -> str:
    """One sentence on what to use; empty without a simple model that predicts every output.

    Args:
        errors: output → RMSE of the network, and RMSE of each simple model, in one unit for each output.
    """
    names = [set(simple) for _, simple in errors.values()]
    common = sorted(set.intersection(*names)) if names else []
    if not common:
        return ""
    ratios = {name: {output: _ratio(own, simple[name]) for output, (own, simple) in errors.items()} for name in common}
    best = max(common, key=lambda name: sum(map(math.log, ratios[name].values())))
    worse = [output for output, ratio in ratios[best].items() if ratio > ALIKE]
    better = [output for output, ratio in ratios[best].items() if ratio < 1.0 / ALIKE]
    if worse and not better:
        factors = _factors([ratios[best][output] for output in worse])
        where = "every output" if len(worse) == len(errors) else listed(worse)
        return f"Use the {best}: its error is {factors} times smaller on {where}."
    if better and not worse:
        factors = _factors([1.0 / ratios[best][output] for output in better])
        where = "every output" if len(better) == len(errors) else listed(better)
        return f"Use the network: its error is {factors} times smaller than that of the best simple model ({best}) on {where}."
    if not worse:
        return f"The {best} is as accurate and simpler."
    return f"The network is more accurate than the {best} on {listed(better)}, and less on {listed(worse)}."


def _ratio(own: float, simple: float) -> float:
    """Bounded, so that an exact model can be compared."""
    return min(max(own / simple if simple > 0.0 else math.inf, 1e-6), 1e6) if own > 0.0 or simple > 0.0 else 1.0


def _factors(values: list[float]) -> str:
    low, high = (f"{value:.1f}" if value < 9.95 else f"{value:.0f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


@dataclass(frozen=True)
class OutputReport:
    """One output of one network on one kind of recordings.

    Args:
        output: the predicted signal, ``boom.joint`` or ``ee.x``.
        inputs: the signals it is predicted from.
        rows: ``motion`` or ``poses``.
        recordings: their names.
        metrics: of the network.
        baselines: name → metrics of a baseline fitted on the same rows.
        noise_floor: RMSE of a perfect map, from the sensor noise of inputs and output in ``machine.toml``; None where it is not
            stated for all of them, and for poses, which are means of many samples.
        profiles: error against position, speed, direction and load.
        spikes: largest first.
        maps: error over two inputs, or an input and its speed, those that explain most first.
        coverage: of the intervals; None for a version without intervals.
    """

    output: str
    inputs: tuple[str, ...]
    rows: Kind
    recordings: tuple[str, ...]
    metrics: ErrorMetrics
    baselines: Mapping[str, ErrorMetrics]
    noise_floor: float | None
    profiles: tuple[Profile, ...]
    spikes: tuple[Spike, ...]
    maps: tuple[ErrorMap, ...] = ()
    coverage: Coverage | None = None

    @property
    def unit(self) -> str:
        return self.metrics.unit


@dataclass(frozen=True)
class ValidationReport:
    """A network evaluated on held-out recordings.

    Args:
        kind: of the network.
        model: name and version, empty for a model that is not registered.
        dataset: name and version.
        outputs: one entry per output and kind of recordings.
        round_trips: axis → errors of joint → cylinder → joint and back of an actuator network.
    """

    kind: Literal["actuator", "history", "motion", "forward"]
    model: str
    dataset: str
    outputs: tuple[OutputReport, ...]
    round_trips: Mapping[str, RoundTripError] = field(default_factory=dict)

    def output(self, name: str, rows: Kind | None = None) -> OutputReport:
        """The first entry of one output, and of one kind of recordings if given."""
        return next(entry for entry in self.outputs if entry.output == name and rows in (None, entry.rows))

    @property
    def recommendation(self) -> str:
        """Whether to use the network or a simple model; empty if none predicts every output."""
        errors = {
            f"{entry.output} ({entry.rows})": (entry.metrics.rmse, {name: m.rmse for name, m in entry.baselines.items()})
            for entry in self.outputs
        }
        return recommendation(errors)

    def metrics(self) -> dict[str, float]:
        """Flat metrics for the model registry: ``boom.joint.motion.rmse`` → value in SI."""
        return {
            f"{entry.output}.{entry.rows}.{key}": float(getattr(entry.metrics, key))
            for entry in self.outputs
            for key in ("rmse", "p95", "max")
        }

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values (NaN becomes null)."""
        values: dict[str, Any] = {
            "kind": self.kind,
            "model": self.model,
            "dataset": self.dataset,
            "role": "held_out",
            "outputs": [asdict(entry) | {"unit": entry.unit} for entry in self.outputs],
            "recommendation": self.recommendation,
            "round_trips": {axis: asdict(trip) for axis, trip in self.round_trips.items()},
        }
        cleaned: dict[str, Any] = plain(values)
        return cleaned
