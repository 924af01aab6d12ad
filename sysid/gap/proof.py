"""The proof: the result of each stage is evaluated once, on held-out recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from sysid.datasets.recording import Recording
from sysid.datasets.roles.needs import is_pose_set
from sysid.effects import flexible_drive
from sysid.gap.candidates import Candidate
from sysid.gap.case import Case, Stage
from sysid.gap.data import Data
from sysid.gap.decision import (
    BESIDE,
    EXPLAINED,
    LOST,
    NOT_EXCITED,
    ORDINARY,
    SHARE,
    Z,
    equivalent_change,
    pays,
    pays_beside,
    typical_errors,
)
from sysid.gap.fit import spread_of
from sysid.gap.floor import problem_floor
from sysid.gap.intervals import jackknifed, known_of
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.localise import stage_rmse
from sysid.gap.problem import Problem, speed_problem
from sysid.gap.result import Alternative, Gap, NamedEffect, NearMissResult, ResidualModelResult, Unnamed, Value
from sysid.gap.sensor_resolution import CoarseSensor
from sysid.gap.servo.ties import sag_tie, without_sensor_names
from sysid.gap.stage_model import StageFit
from sysid.gap.stage_result import AcceptedEffect, StageResult
from sysid.gap.unnamed.residual_formula import describe_residual
from sysid.gap.written import near_misses
from sysid.machine import KnownEffect
from sysid.plant import Plant, PlantNumber, Uncertainty, compile_plant

Array = npt.NDArray[np.float64]

#: Sensor steps are named if they account for this share of the error of the stage above its noise.
MIN_SHARE_OF_STEPS = 0.5
#: A secondary parameter is determined if the half-width of its 95 % interval is at most this share of its value.
DETERMINED = 0.25


@dataclass
class ProofOutcome:
    """Result of all stages together."""

    repaired: Plant
    named: list[NamedEffect] = field(default_factory=list)
    ties: list[tuple[tuple[str, str], ...]] = field(default_factory=list)
    unnamed: list[Unnamed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    carried: list[ResidualModelResult] = field(default_factory=list)
    near_misses: list[NearMissResult] = field(default_factory=list)
    refused: dict[tuple[str, str, str | None], str] = field(default_factory=dict)  # (name, target, side) → why not named


def evaluate(case: Case, stages: Sequence[Stage]) -> ProofOutcome:
    """Put proven effects into the plant, and describe what remains unexplained."""
    outcome = ProofOutcome(case.plant)
    for coarse in case.coarse:
        _add_sensor_steps(case, stages, coarse, outcome)
    known = [without_sensor_names(case, _with_proven_model(case, searched)) for searched in stages]
    for stage in without_cheap_names(known):
        result = stage.found
        proven = bool(result.fit.candidates) and _better(stage)
        refused = dict[str, str]()
        if proven:
            refused = _accept(stage, outcome)
        elif result.named:
            outcome.notes.append(f"{stage.label}: the effects found do not lower the error on held-out recordings")
        if proven and (found := sag_tie(case, stage)) is not None:
            tie, note = found
            outcome.ties += [tie] if not any(tie[-1] in other for other in outcome.ties) else []
            outcome.notes.append(note)
        outcome.notes += _near_misses(stage)
        outcome.notes += result.stage_fit.combinations if result.stage_fit is not None else ()
        outcome.near_misses += near_misses(stage)
        cause = result.stage_fit.cause if result.stage_fit is not None else ""
        if cause:
            error = float(stage_rmse(stage.problem, stage.theta, stage.split.held_out)[0])
            outcome.unnamed.append(Unnamed(stage.problem.stage, stage.problem.target, error, "posture", cause))
            continue
        if proven and all(kept.candidate.label in refused for kept in result.named):
            _without_name(case, stage, refused, outcome)
        # What remains of the forces of an arm shows at its axes, each with its friction.
        if stage.problem.stage != "links" and (result.final_rmse if proven else result.nominal_rmse) > EXPLAINED:
            _describe(case, stage, proven, outcome)
    return outcome


def _with_proven_model(case: Case, searched: Stage) -> Stage:
    """The stage with its intervals; with its named effects alone, if these pass on held-out recordings and all do not.

    Where errors accumulate, effects that are adjusted beside the names compensate for the formulas: they also fail if they
    leave a tenth more than the names alone.
    """
    stage = _with_intervals(case, searched)
    names = searched.found.names_alone
    passes = _better(stage)
    if names is None or (passes and not _accumulates(searched.found)):
        return stage
    alone = _with_intervals(case, replace(searched, result=names))
    whole, least = (held_out_score(each, each.found.fit.theta) for each in (stage, alone))
    if _better(alone) and not (passes and whole <= EXPLAINED * least):
        return alone
    return with_intervals_of(stage, alone) if _accumulates(searched.found) else stage


def with_intervals_of(stage: Stage, alone: Stage) -> Stage:
    """The stage with the intervals of its names alone: the effects adjusted beside them compensate for the formulas."""
    result, names = stage.found, alone.found
    assert result.limits is not None
    assert names.limits is not None
    limits = result.limits.copy()
    for kept in names.named:  # an effect that ties with others is not among them
        here, there = result.fit.rows_of(kept.candidate), names.fit.rows_of(kept.candidate)
        limits[here, 0] = np.minimum(names.limits[there, 0], result.fit.values[here])
        limits[here, 1] = np.maximum(names.limits[there, 1], result.fit.values[here])
    return replace(stage, result=replace(result, limits=limits))


def without_cheap_names(stages: Sequence[Stage]) -> list[Stage]:
    """The stages; where formulas are wrong, without names that held-out recordings excite and that are not worth their price.

    The price is doubled for effects within the error of the machine's other drives (docs/decisions/decision-rule.md). A drive
    whose name is rejected is wrong by its whole error, which counts for the other drives: repeated until none is.
    """
    kept = list(stages)
    for _ in kept:
        typical = typical_errors([_formula_error(stage) for stage in kept])
        checked = [_without_cheap_names_of(stage, error) for stage, error in zip(kept, typical, strict=True)]
        if all(one is other for one, other in zip(kept, checked, strict=True)):
            break
        kept = checked
    return kept


def _without_cheap_names_of(stage: Stage, typical: float) -> Stage:
    """The stage without its cheap names; ``typical``: error of the machine's other drives, as a share of the distance moved."""
    result, fitted = stage.found, stage.found.stage_fit
    if not result.named or fitted is None or fitted.decision.exact:
        return stage
    lost = dict[str, str]()
    for kept in result.named:
        lacks = [_too_cheap(stage, less, theta, typical) for less, theta in comparisons_without(stage, kept.candidate.label)]
        if all(lacks):
            lost[kept.candidate.label] = lacks[0]
    if not lost:
        return stage
    rest = [kept.candidate.label for kept in result.named if kept.candidate.label not in lost]
    if fitted.decision.accumulates and rest:
        others = (comparisons_without(stage, label)[0][0] for label in lost)
        before, *alone = (held_out_score(stage, theta) for theta in (stage.theta, *others))
        if not all(pays(before, after, len(rest)) for after in alone):
            lost |= dict.fromkeys(rest, BESIDE)
    named = tuple(kept for kept in result.named if kept.candidate.label not in lost)
    adjusted = (*result.adjusted, *(kept.candidate for kept in result.named if kept.candidate.label in lost))
    unsure = replace(fitted, decision=fitted.decision.without_names(lost))
    return replace(stage, result=replace(result, named=named, adjusted=adjusted, stage_fit=unsure))


def _too_cheap(stage: Stage, without: Array, theta: Array, typical: float) -> str:
    """Condition that a name fails by a comparison of parameter vectors without and with its effect; empty if it fails none."""
    accumulates = _accumulates(stage.found)
    excited = _excited(stage, without, theta)
    if not excited and not accumulates:
        return ""
    recordings = stage.split.held_out if excited else stage.split.seen
    before, after = (_score(stage, each, recordings) for each in (without, theta))
    if excited and not pays(before, after):
        return LOST
    return "" if pays_beside(before, after, typical * _distance(stage, recordings) if accumulates else 0.0) else ORDINARY


def comparisons_without(stage: Stage, label: str) -> list[tuple[Array, Array]]:
    """Pairs of parameter vectors without and with the effect ``label``; one of them has to prove its name.

    Where errors accumulate, sets of effects were compared by what they leave alone, and the names are tested alone. Effects
    that are adjusted beside them compensate for the formulas in the fitted recordings, which makes others worse, and take the
    place of the effect that is left out. They are also tested beside the one further effect that leaves least: values that the
    owner's plant has not exactly may hide it on the few held-out recordings.
    """
    result = stage.found
    if not _accumulates(result):
        return [(stage.theta, result.fit.theta)]
    pairs = []
    for found in (result.names_alone, result):
        if found is not None and found.stage_fit is not None and label in found.stage_fit.dropped:
            pairs.append((found.stage_fit.dropped[label].theta, found.fit.theta))
            break
    beside = result.stage_fit.beside if result.stage_fit is not None else None
    if beside is not None and label in beside[1]:
        pairs.append((beside[1][label].theta, beside[0].theta))
    return pairs


def _formula_error(stage: Stage) -> float:
    """Error that a drive leaves beside its names, as a share of the distance it moves; zero where its formulas are right.

    Drives of one machine are built alike: the error of their formulas is exchangeable between them (Gelman et al., Bayesian
    Data Analysis, ch. 5), so that the others tell how far that of a drive may move its output.
    """
    if not _accumulates(stage.found):
        return 0.0
    theta = stage.found.fit.theta if stage.found.named else stage.theta
    return held_out_score(stage, theta) / max(_distance(stage, stage.split.held_out), 1e-300)


def _distance(stage: Stage, recordings: Sequence[Recording]) -> float:
    """Distance that the predicted output moves in a recording, mean over recordings and outputs, in noise floors."""
    moved = [np.nansum(np.abs(np.diff(stage.problem.predict(stage.theta[None], r)[0], axis=0)), axis=0) for r in recordings]
    return float(np.mean(np.array(moved) / stage.sigma))


def _with_intervals(case: Case, stage: Stage) -> Stage:
    """The stage with the intervals of its unknowns, where it has names: the hull of those of both likelihoods.

    The posterior of the decision's model includes the discrepancy; the profile of :mod:`sysid.gap.intervals` bounds, thresholds
    and noise of the input. Values of the latter replace those of the model where they leave a tenth less of the free runs.
    """
    result = stage.found
    if not result.named or result.stage_fit is None:
        return stage
    regression = is_pose_set(case.dataset) or stage.problem.stage == "links"  # smooth: the posterior is exact
    if case.adapter is not None or regression:
        return replace(stage, result=replace(result, limits=_limits(result)))
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    limits = _limits(result, _spread_of_parts(seen, stage.theta, result.stage_fit))
    known = known_of(seen, stage.theta, result.fit, case.noise, case.seed)
    limits = np.column_stack([np.minimum(limits[:, 0], known.limits[:, 0]), np.maximum(limits[:, 1], known.limits[:, 1])])
    before, after = (spread_of(seen.residuals(f.theta[None])) for f in (result.fit, known.fit))
    fit = known.fit if EXPLAINED * after < before else result.fit
    return replace(stage, result=replace(result, fit=fit, limits=limits))


def _spread_of_parts(seen: Data, theta: Array, fitted: StageFit) -> Array | None:
    """Half-widths of the least-squares values by the jackknife, where formulas are wrong: the best values depend on motion."""
    alone = fitted.least_squares
    if fitted.decision.exact or not alone.unknowns:
        return None
    return jackknifed(seen, theta, alone.unknowns, alone.values)


def _accumulates(result: StageResult) -> bool:
    """Whether the formulas of a stage are wrong and their errors accumulate."""
    return result.stage_fit is not None and result.stage_fit.decision.accumulates


def _without_name(case: Case, stage: Stage, refused: Mapping[str, str], outcome: ProofOutcome) -> None:
    """Add to ``unnamed`` a stage whose gap is closed by effects that are excited but not certain enough for a name.

    ``refused``: by label, why a name of the decision is not kept.
    """
    result = stage.found
    assert result.stage_fit is not None
    decision = result.stage_fit.decision
    here = {c.label for c in decision.model.candidates}
    lacking = {m.candidate.label: m.lacks for m in decision.near_misses if m.candidate.label in here} | {**refused}
    if not lacking or all(lacks == NOT_EXCITED for lacks in lacking.values()):
        return
    together: dict[str, list[str]] = {}
    for label, lacks in lacking.items():
        together.setdefault(lacks, []).append(label)
    form = "; ".join(f"{' + '.join(labels)} fits, not named: {lacks}" for lacks, labels in together.items())
    depends = next(iter(result.stage_fit.remainder.groups), "nothing that was measured")
    depends = "earlier motion" if depends == "past" else depends
    rmse = float(stage_rmse(stage.problem, stage.theta, stage.split.held_out)[0])
    outcome.unnamed.append(_with_resonance(stage, Unnamed(stage.problem.stage, stage.problem.target, rmse, depends, form)))


def _describe(case: Case, stage: Stage, proven: bool, outcome: ProofOutcome) -> None:
    """Describe the remaining error of a stage: a systematic residual, or a random disturbance, which is no gap."""
    result = stage.found
    assert result.stage_fit is not None
    remainder = result.stage_fit.remainder
    if proven or not result.fit.candidates:
        if remainder.before <= EXPLAINED * max(remainder.after, 1.0):
            outcome.notes.append(
                f"{stage.label}: the remaining error ({remainder.before:.2g} noise floors) is a random disturbance: "
                f"no smooth function of the measured signals explains a tenth of it"
            )
            return
        theta = result.fit.theta
    else:
        theta = stage.theta
    outcome.notes.append(f"{stage.label}: the remaining error depends most on: {next(iter(remainder.groups), 'nothing')}")
    found = describe_residual(stage.problem, theta, stage.split.seen, case.plant.machine)
    outcome.unnamed += [_with_resonance(stage, item) for item in found]


def _with_resonance(stage: Stage, item: Unnamed) -> Unnamed:
    """The residual of a force with the resonance of its drive, where there is one without a name."""
    found = stage.resonance
    if found is None or any(kept.candidate.effect is flexible_drive.EFFECT for kept in stage.found.named):
        return item
    form = f"{item.form}; {found}"
    return replace(item, form=form, antiresonance_hz=found.antiresonance_hz, resonance_hz=found.resonance_hz)


def _better(stage: Stage) -> bool:
    """Whether no held-out signal of the stage gets worse by a tenth, and the whole stage gets better where it is excited."""
    before = stage_rmse(stage.problem, stage.theta, stage.split.held_out)
    after = stage_rmse(stage.problem, stage.found.fit.theta, stage.split.held_out)
    there = ~np.isnan(before) & ~np.isnan(after)
    limit = EXPLAINED * np.maximum(before, stage.sigma)[there]
    whole = float(np.sum((after[there] / stage.sigma[there]) ** 2)) < float(np.sum((before[there] / stage.sigma[there]) ** 2))
    excited = _excited(stage, stage.theta, stage.found.fit.theta)
    return bool(there.any() and (after[there] <= limit).all() and (whole or not excited))


def _add_sensor_steps(case: Case, stages: Sequence[Stage], coarse: CoarseSensor, outcome: ProofOutcome) -> None:
    """Add the steps of a sensor; they are named if they explain the error of its stage above the specified noise."""
    outcome.repaired = outcome.repaired.with_effect(coarse.effect)
    share = max((_explained(case, stage, coarse) for stage in stages if coarse.signal in stage.problem.signals), default=0.0)
    if share >= MIN_SHARE_OF_STEPS:
        found = {"step": coarse.step}, {"step": coarse.interval95}
        outcome.named.append(NamedEffect(coarse.effect.name, coarse.signal, *found, share))
    else:
        outcome.notes.append(f"{coarse.signal} has steps of {coarse.step:.4g}, which exceed its specified noise")


def _explained(case: Case, stage: Stage, coarse: CoarseSensor) -> float:
    """Share of the error of the sensor's stage above its specified noise that its steps explain."""
    k = stage.problem.signals.index(coarse.signal)
    specified = {**case.noise, coarse.signal: coarse.noise}
    floor = float(problem_floor(stage.problem, stage.theta, stage.split.fit, specified, case.seed)[k])
    error = float(stage_rmse(stage.problem, stage.found.fit.theta, stage.split.held_out)[k])
    stepped = float(stage.sigma[k])
    return (min(error, stepped) - floor) / (error - floor) if min(error, stepped) > EXPLAINED * floor else 0.0


def _accept(stage: Stage, outcome: ProofOutcome) -> dict[str, str]:
    """Name the significant effects and put the whole model into the plant; returns by label why effects lose their name."""
    result = stage.found
    refused = dict[str, str]()
    assert result.stage_fit is not None
    limits = result.limits if result.limits is not None else _limits(result)
    adjusted = list(result.adjusted)
    for kept in result.named:
        candidate = kept.candidate
        instance = candidate.instance(result.fit.values_of(candidate))
        shown = ", ".join(f"{key} = {value}" for key, value in instance.parameters.items())
        share = _share(stage, candidate)
        if share < _least_share(result):
            refused[candidate.label] = f"it closes {share:.1%} of the gap on held-out recordings"
        elif _may_be_absent(result, candidate, limits):
            refused[candidate.label] = "its interval contains its absence"
        if candidate.label in refused:
            why = outcome.refused[candidate.key] = refused[candidate.label]
            outcome.notes.append(f"{candidate.effect.name} on {candidate.target} is not named: {why}")
            adjusted.append(candidate)
            continue
        others = {(candidate.effect.name, candidate.target), *candidate.aliases}
        if others & {(e.name, e.target) for e in outcome.named if e.side == candidate.side}:  # a pump shows at several stages
            outcome.notes.append(f"{instance.name} on {instance.target} shows at the {stage.label} as well: {shown}")
            if not kept.ties:
                _use_narrower(outcome, _named(stage, kept, limits, share), instance)
            continue
        outcome.repaired = outcome.repaired.with_effect(instance)
        if kept.ties:
            tie = tuple((c.effect.name, c.target) for c in (candidate, *kept.ties))
            outcome.ties.append(tie)
            outcome.notes.append(
                f"{instance.name} on {instance.target} represents {len(tie)} non-identifiable effects in the plant: {shown}"
            )
        else:
            outcome.named.append(_named(stage, kept, limits, share))
    for candidate in adjusted:
        values = result.fit.values_of(candidate)
        outcome.repaired = outcome.repaired.with_effect(candidate.instance(values))
        if not candidate.effect.fitted:
            continue
        shown = ", ".join(f"{u.key} = {v:.4g}" for u, v in zip(candidate.unknowns, values, strict=True))
        outcome.notes.append(f"{candidate.effect.name} on {candidate.target} is adjusted in the plant without a name: {shown}")
    links = [c.target for c in adjusted if not c.effect.fitted]
    if links:
        outcome.notes.append(f"inertial parameters of the links of {', '.join(links)} are adjusted in the plant without a name")
    known = _uncertainty(result.stage_fit.decision.model, outcome.repaired)
    outcome.repaired = outcome.repaired.with_uncertainty(known) if known.places else outcome.repaired
    return refused


def _least_share(result: StageResult) -> float:
    """Least share of the closable gap of a name.

    Of static poses whose errors are independent noise, the region of practical equivalence alone decides on the size of an
    effect: hundreds of poses determine what moves the tip by half a noise floor, beside offsets that move it by a hundred. The
    same holds for the links of an arm, whose friction is a large part of the forces.
    """
    fitted = result.stage_fit
    if result.problem.stage == "links":
        return float(np.finfo(float).tiny)
    independent = fitted is not None and fitted.framed is not None and fitted.decision.exact
    return float(np.finfo(float).tiny) if independent else SHARE


def _use_narrower(outcome: ProofOutcome, found: NamedEffect, instance: KnownEffect) -> None:
    """Use the values with the narrowest interval of an effect that several stages show."""
    for k, known in enumerate(outcome.named):
        same = (known.name, known.target, known.side) == (found.name, found.target, found.side)
        if same and _width(found) < _width(known):
            outcome.named[k] = found
            outcome.repaired = outcome.repaired.with_effect(instance)


def _width(effect: NamedEffect) -> float:
    """Width of the widest interval of its parameters."""
    return max(float(np.max(np.abs(np.subtract(*ends)))) for ends in effect.interval95.values())


def _near_misses(stage: Stage) -> list[str]:
    """Notes on the near misses, with their values and the condition that each fails."""
    fitted = stage.found.stage_fit
    if fitted is None:
        return []
    found = []
    for miss in fitted.decision.near_misses:
        values = ", ".join(
            f"{u.key} = {v:.4g} ± {Z * d:.2g}"
            for u, v, d in zip(miss.candidate.unknowns, miss.values, miss.deviations, strict=True)
        )
        found.append(f"near miss at the {stage.label}: {miss.candidate.label} ({values}): {miss.lacks}")
    return found


def _limits(result: StageResult, spread: Array | None = None) -> Array:
    """95 % intervals of the unknowns of the chosen model, (k, 2), within their bounds.

    The hull of the interval of the stage's likelihood and that of the free run with the named effects alone, which differ where
    the formulas are wrong. Where their errors accumulate, of the likelihood only the estimate counts.

    Args:
        spread: half-widths of the latter by the differences between parts of the recordings.
    """
    fitted = result.stage_fit
    assert fitted is not None
    model, alone = fitted.decision.model, fitted.least_squares
    limits, least = (_interval(f, fitted.decision.exact, wide) for f, wide in ((model, None), (alone, spread)))
    accumulates = _accumulates(result)
    for candidate in alone.candidates:
        if candidate.label in model.labels:
            here, there = model.rows_of(candidate), least[alone.rows_of(candidate)]
            kept = np.repeat(model.values[here, None], 2, axis=1) if accumulates else limits[here]
            limits[here, 0], limits[here, 1] = np.minimum(kept[:, 0], there[:, 0]), np.maximum(kept[:, 1], there[:, 1])
    low = np.array([u.bounds[0] for u in model.unknowns])
    high = np.array([u.bounds[1] for u in model.unknowns])
    return np.clip(limits, low[:, None], high[:, None])


def _may_be_absent(result: StageResult, candidate: Candidate, limits: Array) -> bool:
    """Whether the intervals of all its parameters contain the known value."""
    here = limits[result.fit.rows_of(candidate)]
    nominal = np.array([u.nominal for u in candidate.unknowns])
    return bool(((here[:, 0] <= nominal) & (nominal <= here[:, 1])).all())


def _interval(model: ModelFit, exact: bool, spread: Array | None) -> Array:
    """95 % intervals of a normal posterior, (k, 2), at least ``spread`` to both sides.

    Where the formulas are wrong, they include what the discrepancy could do in place of an effect.
    """
    half = Z * np.hypot(np.sqrt(np.diag(model.covariance)), 0.0 if exact else model.confounded)
    half = half if spread is None else np.maximum(half, spread)
    return np.asarray(model.values[:, None] + half[:, None] * [-1.0, 1.0])


def _uncertainty(model: ModelFit, plant: Plant) -> Uncertainty:
    """Covariance of those parameters of a stage's fit that the plant has (others are represented by an alias)."""
    places, kept = list[PlantNumber](), list[int]()
    for candidate in model.candidates:
        name, target, side = candidate.key
        if plant.effect(name, target, side) is None:
            continue
        kept += range(len(model.unknowns))[model.rows_of(candidate)]
        for parameter in candidate.form.parameters:
            places += [PlantNumber(name, target, side, parameter.name, k) for k in range(len(parameter.components))]  # type: ignore[arg-type]
    return Uncertainty(tuple(places), model.covariance[np.ix_(kept, kept)])


def _named(stage: Stage, kept: AcceptedEffect, limits: Array, share: float) -> NamedEffect:
    candidate, fit = kept.candidate, stage.found.fit
    begin = fit.rows_of(candidate).start
    parameters: dict[str, Value] = {}
    interval: dict[str, tuple[Any, Any]] = {}
    undetermined: list[str] = []
    for parameter in candidate.form.parameters:
        here = slice(begin, begin + len(parameter.components))
        ends = simultaneous(fit.values[here], limits[here])
        value, low, high = (tuple(map(float, column)) for column in (fit.values[here], ends[:, 0], ends[:, 1]))
        single = len(value) == 1
        parameters[parameter.name] = value[0] if single else value
        interval[parameter.name] = (low[0], high[0]) if single else (low, high)
        if parameter.secondary and single and high[0] - low[0] > 2.0 * DETERMINED * abs(value[0]):
            undetermined.append(parameter.name)
        begin = here.stop
    return NamedEffect(
        candidate.effect.name,
        candidate.target,
        parameters,
        interval,
        share,
        tuple(Alternative(c.effect.name, c.target, why) for c, why in kept.rejected),
        candidate.aliases,
        side=candidate.side,
        evidence=kept.evidence,
        undetermined=tuple(undetermined),
    )


def simultaneous(values: Array, limits: Array) -> Array:
    """Intervals (n, 2) that contain all ``n`` components of a vector with 95 % (Bonferroni), from those of each component."""
    wider = norm.ppf(1.0 - 0.025 / len(values)) / Z
    return np.asarray(values[:, None] + wider * (limits - values[:, None]))


def _share(stage: Stage, candidate: Candidate) -> float:
    """Closed share of the held-out stage gap that is lost when the effect is dropped and the rest refitted."""
    fitted = stage.found.stage_fit
    assert fitted is not None
    dropped = fitted.dropped[candidate.label]
    excited = _excited(stage, dropped.theta, stage.found.fit.theta)
    recordings = stage.split.held_out if excited else stage.split.seen
    first, framed = stage.theta, fitted.framed
    if (
        framed is not None
        and candidate.target not in ("base", "ee")
        and any(c.target == "base" for c in fitted.decision.model.candidates)
    ):
        first = framed.theta  # the frame closes most of the gap of a pose set
    before, after, less = (_score(stage, theta, recordings) for theta in (first, stage.found.fit.theta, dropped.theta))
    return float(np.clip((less - after) / (before - 1.0), 0.0, 1.0)) if before > 1.0 else 0.0


def _excited(stage: Stage, without: Array, theta: Array) -> bool:
    """Whether held-out recordings excite the difference between a model ``theta`` and ``without`` an effect.

    The output has to change by more than the region of practical equivalence of :mod:`sysid.gap.decision`.
    """
    score = held_out_score(stage, theta)
    moved = [np.diff(stage.problem.predict(np.array([without, theta]), r), axis=0)[0] for r in stage.split.held_out]
    size = float(np.sqrt(np.nanmean((np.concatenate(moved) / stage.sigma) ** 2)))
    return held_out_score(stage, stage.theta) > EXPLAINED and size > equivalent_change(score)


def held_out_score(stage: Stage, theta: Array) -> float:
    """Held-out RMSE of the stage in noise floors."""
    return _score(stage, theta, stage.split.held_out)


def _score(stage: Stage, theta: Array, recordings: Sequence[Recording]) -> float:
    return float(np.sqrt(np.nanmean((stage_rmse(stage.problem, theta, recordings) / stage.sigma) ** 2)))


def with_carried(gap: Gap, outcome: ProofOutcome) -> Gap:
    """The gap by stage, with the accepted residual networks in ``after``."""
    accepted = [item for item in outcome.carried if item.accepted]
    after = {**gap.after, **{item.signal: item.after for item in accepted}}
    return replace(gap, after=after, noise_floor={**gap.noise_floor, **{item.signal: item.noise_floor for item in accepted}})


def stage_gap(case: Case, stages: Sequence[Stage], repaired: Array) -> Gap:
    """RMSE of every stage driven by its measured input, on held-out recordings; of the speeds of command stages too."""
    before: dict[str, float] = {}
    after: dict[str, float] = {}
    floor: dict[str, float] = {}
    # The forces of the links stage are outputs of the axes' stages too.
    own = ((s.problem, s.split.held_out) for s in stages if s.problem.stage != "links")
    for problem, held_out in (*own, *_speeds(case, stages)):
        for values, scores in (
            (before, stage_rmse(problem, case.theta, held_out)),
            (after, stage_rmse(problem, repaired, held_out)),
            (floor, problem_floor(problem, repaired, held_out, case.noise, case.seed)),
        ):
            values.update(zip(problem.signals, map(float, scores), strict=True))
    return Gap(before, after, floor)


def _speeds(case: Case, stages: Sequence[Stage]) -> list[tuple[Problem, Sequence[Recording]]]:
    """The speed of every command stage of a plant that held-out recordings contain, and these recordings."""
    if case.adapter is not None:
        return []
    model, found = compile_plant(case.plant), list[tuple[Problem, Sequence[Recording]]]()
    for stage in stages:
        if stage.problem.stage == "command":
            problem = speed_problem(model, case.plant.machine.axis(stage.problem.target))
            measured = [r for r in stage.split.held_out if not np.isnan(problem.measured(r)).all()]
            if measured:
                found.append((problem, measured))
    return found
