"""Result of the gap workflow, as frozen values and as JSON (``docs/result.md``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from sysid.gap.statement import Agreement, CommandOrder, Missing, ResponseDifference, Verdict, headline
from sysid.gap.thresholds import at_floor
from sysid.registry.promotion import Check as Check
from sysid.registry.promotion import Promotion as Promotion

if TYPE_CHECKING:
    from sysid.gap.experiment.experiment import Experiment

#: Folder of the planned recordings, beside the result.
EXPERIMENTS = "experiments"

Value = float | tuple[float, ...]


@dataclass(frozen=True)
class Alternative:
    """Another effect that was compared for the same error and rejected, and why."""

    name: str
    target: str
    rejected_by: str


@dataclass(frozen=True)
class EffectEvidence:
    """Evidence for an effect: the model with it against the model without it, the rest refitted.

    Args:
        delta_bic: twice the difference in log evidence; above 10 is very strong evidence for the effect.
        nats: log predictive density gained, each block predicted from all others.
        p_value: probability of such a gain by chance.
        ratio: standard deviation of what neither effects nor discrepancy explain, without to with the effect.
    """

    delta_bic: float
    nats: float
    p_value: float
    ratio: float


def _check_intervals(parameters: Mapping[str, Value], interval95: Mapping[str, tuple[Value, Value]]) -> None:
    for name, ends in interval95.items():
        if len({np.shape(value) for value in (parameters.get(name, ends[0]), *ends)}) > 1:
            raise ValueError(f"an interval with the components of {name}")


@dataclass(frozen=True)
class NamedEffect:
    """A missing effect with its parameters (absolute values in the repaired plant).

    Args:
        undetermined: secondary parameters of the repaired plant that no recording determines.
        units: SI unit of each parameter.
    """

    name: str
    target: str
    parameters: Mapping[str, Value]
    interval95: Mapping[str, tuple[Value, Value]]
    gap_share: float
    alternatives: tuple[Alternative, ...] = ()
    aliases: tuple[tuple[str, str], ...] = ()
    side: str | None = None
    evidence: EffectEvidence | None = None
    undetermined: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the intervals.

        Raises:
            ValueError: an interval of other components than its value.
        """
        _check_intervals(self.parameters, self.interval95)

    @property
    def given(self) -> dict[str, Value]:
        """The parameters that the recordings determine."""
        return {key: value for key, value in self.parameters.items() if key not in self.undetermined}


@dataclass(frozen=True)
class WrittenEffect:
    """An effect whose values the repair writes into the plant, with a name or without.

    Args:
        kind: ``named``; ``tied``, which represents effects that the recordings cannot distinguish; ``adjusted``, fitted beside
            the named ones without a name of its own.
        parameters: SI values in the repaired plant.
        before: those of the plant under test, where it contains the effect; else empty.
        interval95: by parameter; without those whose uncertainty is unknown.
        gap_share: of a named effect; else None.
        why: of an adjusted one, the condition for a name that it fails.
        units: SI unit of each parameter.
    """

    name: str
    target: str
    kind: Literal["named", "tied", "adjusted"]
    parameters: Mapping[str, Any]
    before: Mapping[str, Any] = field(default_factory=dict)
    interval95: Mapping[str, tuple[Value, Value]] = field(default_factory=dict)
    gap_share: float | None = None
    why: str = ""
    side: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the intervals, see :class:`NamedEffect`."""
        _check_intervals(self.parameters, self.interval95)


@dataclass(frozen=True)
class AxisDelay:
    """Dead time and lag of an axis in the plant under test and in the repaired one, each (before, after) [s]."""

    axis: str
    dead_time: tuple[float, float]
    lag: tuple[float, float]

    @property
    def total(self) -> tuple[float, float]:
        """Dead time and lag together: the delay of a slow ramp."""
        return self.dead_time[0] + self.lag[0], self.dead_time[1] + self.lag[1]


@dataclass(frozen=True)
class ForceComparison:
    """Filter under which the force of an axis is compared, chosen from its recordings (:mod:`sysid.plant.force_band`).

    Args:
        bandwidth_hz, position_hz: cut-off of both forces, and of the position before it is differentiated [Hz].
        delay: by which the logged force is ahead of the measured motion [s].
    """

    axis: str
    bandwidth_hz: float
    position_hz: float
    delay: float


@dataclass(frozen=True)
class NearMissResult:
    """An effect of a model that predicts about as well as the chosen one, and the condition for a name that it fails.

    Args:
        parameters, interval95: fitted values [SI] and their 95 % intervals.
        distance: of its values from those of the plant under test and from zero, in standard deviations; the largest of its
            parameters. Small where the recordings do not determine it.
        units: SI unit of each parameter.
    """

    name: str
    target: str
    stage: str
    parameters: Mapping[str, float]
    interval95: Mapping[str, tuple[float, float]]
    distance: float
    lacks: str
    side: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Probe:
    """Cross-correlation of a residual with a measured variable ``lag`` seconds earlier.

    ``bound``: exceeded by an independent residual in 1 % of cases, over all variables and lags together.
    """

    name: str
    correlation: float
    bound: float
    lag: float = 0.0


@dataclass(frozen=True)
class Unnamed:
    """Residual of a stage that no effect of the catalogue explains.

    Args:
        rmse: of the stage, driven by its measured input.
        depends_on: measured variables it depends on, the strongest first; else ``nothing that was measured``.
        form: a formula in SI units, or why there is none.
        explains: share of the variance of the residual (of its rate, where the stage integrates) that the formula predicts
            on recordings left out of its search; zero without one.
        period, period_unit: of a ripple in the formula; zero without one.
        probes: the largest cross-correlations.
        antiresonance_hz, resonance_hz: of a load behind a spring in a force [Hz]; zero without one.
    """

    stage: str
    target: str
    rmse: float
    depends_on: str
    form: str
    explains: float = 0.0
    period: float = 0.0
    period_unit: str = ""
    probes: tuple[Probe, ...] = ()
    antiresonance_hz: float = 0.0
    resonance_hz: float = 0.0


@dataclass(frozen=True)
class ResidualModelResult:
    """Residual network of a stage that no effect explains (``unnamed_residual``), or the reason why there is none.

    It is trained on the recordings, is not physics, and is not listed among the effects.

    Args:
        signal: the output that it acts on.
        before, after, noise_floor: held-out RMSE of the stage without it, with it, and of the true model.
        accepted: whether the repaired plant contains it.
        text: its effect, or why it was rejected.
        bound: of its output: a share of the speed (velocity axis), or the position (servo), the joint, or the force.
        inputs: names of its inputs.
    """

    stage: str
    target: str
    signal: str
    before: float
    after: float
    noise_floor: float
    accepted: bool
    text: str
    bound: float = 0.0
    inputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Excitation:
    """Whether the recordings excite an effect: ``have`` of ``need``, in ``unit``."""

    name: str
    target: str
    sufficient: bool
    have: float
    need: float
    unit: str = ""


@dataclass(frozen=True)
class Gap:
    """RMSE per signal before and after the repair, and of the true model (noise floor)."""

    before: Mapping[str, float]
    after: Mapping[str, float]
    noise_floor: Mapping[str, float]

    def closed(self, signal: str) -> float:
        """(before − after) / (before − noise_floor); NaN where there is no gap."""
        closable = self.before[signal] - self.noise_floor[signal]
        return (self.before[signal] - self.after[signal]) / closable if closable > 0 else float("nan")


@dataclass(frozen=True)
class WorldGap:
    """The gap in the PyBullet world, with the held-out commands, before and after the repair.

    Args:
        world: RMSE by signal in the world; ``noise_floor`` as of the compiled plant.
        compiled: RMSE of the compiled plant on the same rows.
        recordings: those that were run.
        seconds: duration [s].
        skipped: why recordings were not run; else empty.
    """

    world: Gap
    compiled: Gap
    recordings: tuple[str, ...] = ()
    seconds: float = 0.0
    skipped: str = ""


@dataclass(frozen=True)
class ComparedModel:
    """One row of the evidence table: a fitted set of effects; errors in whitened standard deviations."""

    stage: str
    target: str
    effects: tuple[str, ...]
    parameters: Mapping[str, float]
    fit_rmse: float
    selection_rmse: float
    delta_bic: float
    verdict: str


@dataclass(frozen=True)
class StageGap:
    """Error of one stage output: driven by its measured input (``stage``) and in the free run (``free_run``).

    Args:
        share: of the total error over all outputs, in noise floors.
        frequency: of an oscillating error [Hz], else zero.
    """

    stage: str
    target: str
    signal: str
    stage_rmse: float
    free_run_rmse: float
    noise_floor: float
    share: float
    frequency: float = 0.0

    @property
    def disagrees(self) -> bool:
        """Whether its stage is above the noise floor."""
        return not at_floor(self.stage_rmse / self.noise_floor)


@dataclass(frozen=True)
class Share:
    """Contribution of one stage to the free-run error at the end of a chain (``tool``, ``ee`` or a joint).

    Args:
        share: of the mean square; the shares of an end add up to one, a negative one compensates for others.
        moved: RMS change of the prediction when this stage is simulated instead of measured [m or rad].
        rmse: total error at that end [m or rad].
    """

    end: str
    stage: str
    target: str
    share: float
    moved: float
    rmse: float


@dataclass(frozen=True)
class Map:
    """Error of a stage output over a variable, in bins.

    Args:
        over, unit: the variable: a signal, ``speed of boom``, ``direction of boom``, ``load of boom``, ``time``, ….
        quantity: ``error`` or ``speed error`` (measured − simulated), in ``error_unit``.
        noise_floor: standard deviation that sensor noise gives it.
        explains: share of the variance that the bin means explain (0 … 1).
        at: median of the variable in each bin; ``count`` rows, ``mean`` and robust standard deviation ``spread`` of the error
            there.
        after: the mean with the repair; empty without one.
        measured, simulated: mean speeds, where speeds are compared; else empty.
    """

    stage: str
    target: str
    signal: str
    over: str
    unit: str
    quantity: str
    error_unit: str
    noise_floor: float
    explains: float
    at: tuple[float, ...]
    count: tuple[int, ...]
    mean: tuple[float, ...]
    spread: tuple[float, ...]
    after: tuple[float, ...] = ()
    measured: tuple[float, ...] = ()
    simulated: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Check the lengths and the places.

        Raises:
            ValueError: no bin, a bin without a place, or curves of other lengths.
        """
        bins, optional = len(self.at), (self.after, self.measured, self.simulated)
        if not bins or {len(self.count), len(self.mean), len(self.spread), *map(len, filter(None, optional))} != {bins}:
            raise ValueError("one value for each bin of a map")
        if not all(map(math.isfinite, self.at)):
            raise ValueError("a finite place of each bin of a map")


@dataclass(frozen=True)
class Traces:
    """A held-out recording: measured, and simulated before and after the repair (columns = signals, same rows)."""

    recording: str
    measured: pd.DataFrame
    before: pd.DataFrame
    after: pd.DataFrame


#: An error that was not measured.
NOT_MEASURED = Gap({}, {}, {})


@dataclass(frozen=True, repr=False)
class GapResult:
    """Result of the workflow (``docs/result.md``).

    ``experiments`` are recordings planned to resolve open hypotheses; ``next_experiment`` lists recordings to make as text.
    ``machine_diff`` is the change of ``machine.toml`` by the repair, as a unified diff; a stored repair has a ``promotion``.
    ``carried`` are residual networks, which are not effects. ``written`` are all effects whose values the repair changes, the
    named ones first; ``near_misses`` those that lack one condition for a name.
    ``delays`` has the axes of which a dead time or a lag is known, ``forces`` the force axes that were compared.
    ``missing`` are parts that could not be computed; their fields are empty. ``order`` is None where nothing depends on it.
    ``agreement`` has every signal on held-out recordings; verdict and ``headline`` follow from it. ``responses`` are figures
    that held-out recordings show without a model, where the repaired simulation differs.
    """

    dataset: str
    plant_before: str
    plant_after: str
    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    unnamed: tuple[Unnamed, ...]
    ambiguous: tuple[tuple[tuple[str, str], ...], ...]
    next_experiment: tuple[str, ...]
    gap: Gap
    stage_gap: Gap
    excitation: tuple[Excitation, ...]
    held_out_recordings: tuple[str, ...]
    seconds: float
    localised: tuple[StageGap, ...] = ()
    candidates: tuple[ComparedModel, ...] = ()
    traces: tuple[Traces, ...] = ()
    notes: tuple[str, ...] = ()
    experiments: tuple[Experiment, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    shares: tuple[Share, ...] = ()
    maps: tuple[Map, ...] = ()
    world_gap: WorldGap | None = None
    machine_diff: str = ""
    promotion: Promotion | None = None
    carried: tuple[ResidualModelResult, ...] = ()
    written: tuple[WrittenEffect, ...] = ()
    near_misses: tuple[NearMissResult, ...] = ()
    delays: tuple[AxisDelay, ...] = ()
    forces: tuple[ForceComparison, ...] = ()
    missing: tuple[Missing, ...] = ()
    order: CommandOrder | None = None
    agreement: tuple[Agreement, ...] = ()
    responses: tuple[ResponseDifference, ...] = ()

    @property
    def headline(self) -> str:
        """The verdict in words, with the largest error that remains."""
        above = any(item.disagrees for item in self.localised)
        found = "located" if self.verdict == "unnamed" and self.settings.get("localise_only") else self.verdict
        return headline(found, len(self.effects), self.agreement, disagrees=above or bool(self.unnamed))

    def __repr__(self) -> str:
        return f"GapResult({self.dataset}: {self.headline})"

    @property
    def repaired(self) -> bool:
        """Whether the repaired plant differs: it has named effects or a residual network."""
        return bool(self.effects) or any(item.accepted for item in self.carried)

    def names_on(self, target: str) -> frozenset[str]:
        """Names of the effects found on one target."""
        return frozenset(effect.name for effect in self.effects if effect.target == target)

    def to_json(self, folder: Path | None = None) -> dict[str, Any]:
        """The result as JSON values.

        Args:
            folder: of the result, for the paths of experiments; by default they are relative to it.
        """
        return {
            "schema": 1,
            "dataset": self.dataset,
            "plant": {"before": self.plant_before, "after": self.plant_after},
            "verdict": self.verdict,
            "headline": self.headline,
            "effects": [_effect_json(effect) for effect in self.effects],
            "unnamed": [asdict(item) for item in self.unnamed],
            "ambiguous": [[{"name": name, "target": target} for name, target in tie] for tie in self.ambiguous],
            "next_experiment": list(self.next_experiment),
            "gap": asdict(self.gap),
            "stage_gap": asdict(self.stage_gap),
            "agreement": [asdict(item) for item in self.agreement],
            "responses": [asdict(item) for item in self.responses],
            "floor_source": {item.signal: item.floor_source for item in self.agreement},
            "excitation": [asdict(item) for item in self.excitation],
            "held_out_recordings": list(self.held_out_recordings),
            "seconds": self.seconds,
            "localised": [asdict(item) for item in self.localised],
            "shares": [asdict(item) for item in self.shares],
            "maps": [asdict(item) for item in self.maps],
            "candidates": [asdict(item) for item in self.candidates],
            "written": [_given(item) for item in self.written],
            "delays": [asdict(item) for item in self.delays],
            "forces": [asdict(item) for item in self.forces],
            "near_misses": [_given(item) for item in self.near_misses],
            "notes": list(self.notes),
            "missing": [asdict(item) for item in self.missing],
            "convention": _order_json(self.order),
            "experiments": [_experiment_json(item, folder or Path()) for item in self.experiments],
            "settings": dict(self.settings),
            "world_gap": None if self.world_gap is None else _world_json(self.world_gap),
            "machine_diff": self.machine_diff,
            "carried": [asdict(item) for item in self.carried],
            "promotion": None if self.promotion is None else {"promoted": self.promotion.promoted, **asdict(self.promotion)},
        }


def _order_json(order: CommandOrder | None) -> dict[str, Any]:
    if order is None:
        return {}
    return {order.stream: {"convention": order.convention, "source": order.source, "open_s": order.open_s}}


def _given(item: WrittenEffect | NearMissResult) -> dict[str, Any]:
    """Its fields that have a value: side and share are absent where there is none."""
    return {key: value for key, value in asdict(item).items() if value is not None}


def _effect_json(effect: NamedEffect) -> dict[str, Any]:
    entry = {
        "name": effect.name,
        "target": effect.target,
        "parameters": effect.given,
        "interval95": {key: list(effect.interval95[key]) for key in effect.given},
        "units": dict(effect.units),
        "gap_share": effect.gap_share,
        "alternatives": [asdict(alternative) for alternative in effect.alternatives],
    }
    if effect.aliases:
        entry["aliases"] = [{"name": name, "target": target} for name, target in effect.aliases]
    if effect.undetermined:
        entry["undetermined"] = {
            key: {"in_plant": effect.parameters[key], "interval95": list(effect.interval95[key])} for key in effect.undetermined
        }
    if effect.side is not None:
        entry["side"] = effect.side
    if effect.evidence is not None:
        entry["evidence"] = asdict(effect.evidence)
    return entry


def _world_json(found: WorldGap) -> dict[str, Any]:
    """The gap in the world as in ``gap``, with that of the compiled plant."""
    return {**asdict(found.world), "compiled": asdict(found.compiled), "recordings": list(found.recordings),
            "seconds": found.seconds, "skipped": found.skipped}  # fmt: skip


def _experiment_json(experiment: Experiment, folder: Path) -> dict[str, Any]:
    """File, duration and purposes of an experiment."""
    return {
        "name": experiment.name,
        "file": (folder / EXPERIMENTS / f"{experiment.name}.toml").as_posix(),
        "axes": list(experiment.axes),
        "seconds": experiment.seconds,
        "repeats": experiment.repeats,
        "text": experiment.words,
        "purposes": [asdict(purpose) for purpose in experiment.purposes],
    }
