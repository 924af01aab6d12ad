"""The proof: the result of each stage is evaluated once, on held-out recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import flexible_drive, gain_error, inertia_error
from sysid.gap.arm.sag_ties import sag_tie, without_sensor_names
from sysid.gap.arm.servos import with_coupled_values
from sysid.gap.candidates import Candidate
from sysid.gap.comparison import clearly_worse
from sysid.gap.disagreement import stage_rmse
from sysid.gap.held_out import (
    held_out_error,
    is_better,
    is_excited,
    relative_error,
    without_cheap_names,
)
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.prepare.noise import problem_floor
from sysid.gap.prepare.resolution import CoarseSensor
from sysid.gap.reasons import Reason
from sysid.gap.result import Alternative, Gap, NamedEffect, NearMissResult, ResidualModelResult, Unnamed, Value
from sysid.gap.stage_intervals import limits_of, may_be_absent, simultaneous, with_intervals, with_intervals_of
from sysid.gap.stage_result import AcceptedEffect, StageResult
from sysid.gap.statement import AGREES
from sysid.gap.thresholds import Z, as_little, at_floor
from sysid.gap.unnamed.description import describe_period, describe_residual
from sysid.gap.unnamed.instead import without_names_of_position, without_periodic_names
from sysid.gap.written import near_misses
from sysid.machine import EffectKey, KnownEffect
from sysid.plant import Plant, PlantNumber, Uncertainty

Array = npt.NDArray[np.float64]

#: Effects that correct a value of the description, by its key in machine.toml.
DESCRIBED = {gain_error.EFFECT.name: "gain", inertia_error.EFFECT.name: "inertia"}
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
    refused: dict[EffectKey, Reason] = field(default_factory=dict)
    adjusted: dict[EffectKey, Candidate] = field(default_factory=dict)


def evaluate(case: Case, stages: Sequence[Stage]) -> ProofOutcome:
    """Put proven effects into the plant, and describe what remains unexplained."""
    outcome = ProofOutcome(case.plant)
    for coarse in case.coarse:
        _add_sensor_steps(case, stages, coarse, outcome)
    known = [without_sensor_names(case, _with_proven_model(case, searched)) for searched in stages]
    machine = case.plant.machine
    smooth = [without_names_of_position(without_periodic_names(stage, machine), machine) for stage in known]
    for stage in map(without_cheap_names, smooth):
        result = stage.found
        proven = bool(result.fit.candidates) and is_better(stage)
        refused = dict[str, Reason]()
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
        searched = result.stage_fit is not None and not stage.problem.kind.whole_arm
        if searched and not at_floor(result.final_rmse if proven else result.nominal_rmse):
            _describe(case, stage, proven, outcome)
    outcome.repaired, outcome.named = with_coupled_values(case, known, outcome.repaired, outcome.named)
    outcome.notes += _adjusted_notes(case, outcome)
    return _without_estimates(case, outcome)


def _adjusted_notes(case: Case, outcome: ProofOutcome) -> list[str]:
    """What the plant has without a name, with its values, and what it does not need beside the names."""
    theta, shown, left_out, links = outcome.repaired.vector(), list[str](), list[str](), list[str]()
    for key, candidate in outcome.adjusted.items():
        where = f"{candidate.effect.name} on {candidate.target}"
        if outcome.repaired.effect(*key) == case.plant.effect(*key):
            left_out.append(where)
        elif not candidate.effect.fitted:
            links.append(candidate.target)
        else:
            values = ", ".join(f"{u.key} = {theta[u.places[0]]:.4g}" for u in candidate.unknowns)
            shown.append(f"{where} is adjusted in the plant without a name: {values}")
    if links:
        shown.append(f"inertial parameters of the links of {', '.join(links)} are adjusted in the plant without a name")
    if left_out:
        shown.append(f"not in the plant, because the motion of the whole arm does not need it: {', '.join(left_out)}")
    return shown


def _without_estimates(case: Case, outcome: ProofOutcome) -> ProofOutcome:
    """The outcome without names for better values of what the description only estimates; the repair has them."""
    machine = case.plant.machine
    estimated = {(name, axis.name) for name, key in DESCRIBED.items() for axis in machine.axes if key in axis.estimated}
    for effect in outcome.named:
        if (effect.name, effect.target) in estimated:
            outcome.refused[effect.name, effect.target, effect.side] = Reason.ESTIMATED
    outcome.named = [effect for effect in outcome.named if (effect.name, effect.target) not in estimated]
    return outcome


def _with_proven_model(case: Case, searched: Stage) -> Stage:
    """The stage with its intervals; with its named effects alone, if these pass on held-out recordings and all do not.

    Where errors accumulate, effects that are adjusted beside the names compensate for the formulas: they also fail if they
    leave a tenth more than the names alone.
    """
    stage = with_intervals(case, searched)
    names = searched.found.names_alone
    passes = is_better(stage)
    if names is None or (passes and not searched.found.accumulates):
        return stage
    alone = with_intervals(case, replace(searched, result=names))
    whole, least = (held_out_error(each, each.found.fit.theta) for each in (stage, alone))
    if is_better(alone) and not (passes and as_little(whole, least)):
        return alone
    return with_intervals_of(stage, alone) if searched.found.accumulates else stage


def _without_name(case: Case, stage: Stage, refused: Mapping[str, Reason], outcome: ProofOutcome) -> None:
    """Add to ``unnamed`` a stage whose gap is closed by effects that are excited but not certain enough for a name.

    ``refused``: by label, why a name of the decision is not kept.
    """
    result = stage.found
    assert result.stage_fit is not None
    decision = result.stage_fit.decision
    here = {c.label for c in decision.model.candidates}
    lacking = {m.candidate.label: m.lacks for m in decision.near_misses if m.candidate.label in here} | {**refused}
    if not lacking or all(lacks is Reason.NOT_EXCITED for lacks in lacking.values()):
        return
    together: dict[Reason, list[str]] = {}
    for label, lacks in lacking.items():
        together.setdefault(lacks, []).append(label)
    form = "; ".join(f"{' + '.join(labels)} fits, not named: {lacks}" for lacks, labels in together.items())
    depends = next(iter(result.stage_fit.remainder.groups), "nothing that was measured")
    depends = "earlier motion" if depends == "past" else depends
    rmse = float(stage_rmse(stage.problem, stage.theta, stage.split.held_out)[0])
    outcome.unnamed.append(_with_resonance(stage, Unnamed(stage.problem.stage, stage.problem.target, rmse, depends, form)))


def _describe(case: Case, stage: Stage, proven: bool, outcome: ProofOutcome) -> None:
    """Describe the remaining error of a stage: a systematic residual, or a random disturbance."""
    result = stage.found
    assert result.stage_fit is not None
    remainder = result.stage_fit.remainder
    if proven or not result.fit.candidates:
        theta = result.fit.theta
        if as_little(remainder.before, remainder.after):
            if found := describe_period(stage.problem, theta, stage.split.seen, case.plant.machine):
                outcome.unnamed += found
                return
            size = f"{remainder.before:.2g} noise floors"
            form = f"a random disturbance ({size}): no smooth function of the measured signals explains a tenth of it"
            here = stage.problem.stage, stage.problem.target
            if remainder.before <= AGREES or any((item.stage, item.target) == here for item in outcome.unnamed):
                outcome.notes.append(f"{stage.label}: the remaining error is {form}")
                return
            error = float(stage_rmse(stage.problem, theta, stage.split.held_out)[0])
            outcome.unnamed.append(Unnamed(*here, error, "nothing that was measured", form))
            return
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
    """Share of the error of the sensor's stage above its specified noise that its steps explain.

    Effects of the stage that do not lower its error on held-out recordings are not in the plant.
    """
    k = stage.problem.signals.index(coarse.signal)
    specified = {**case.noise, coarse.signal: coarse.noise}
    floor = float(problem_floor(stage.problem, stage.theta, stage.split.fit, specified, case.seed)[k])
    tried = (stage.theta, stage.found.fit.theta)
    error = min(float(stage_rmse(stage.problem, theta, stage.split.held_out)[k]) for theta in tried)
    stepped = float(stage.sigma[k])
    return (min(error, stepped) - floor) / (error - floor) if not at_floor(min(error, stepped) / floor) else 0.0


def _accept(stage: Stage, outcome: ProofOutcome) -> dict[str, Reason]:
    """Name the significant effects and put the whole model into the plant; returns by label why effects lose their name."""
    result = stage.found
    refused = dict[str, Reason]()
    assert result.stage_fit is not None
    limits = result.limits if result.limits is not None else limits_of(result)
    adjusted = list(result.adjusted)
    for kept in result.named:
        candidate = kept.candidate
        instance = candidate.instance(result.fit.values_of(candidate))
        shown = ", ".join(f"{key} = {value}" for key, value in instance.parameters.items())
        share = _share(stage, candidate)
        elsewhere = _is_named(candidate, outcome)  # a pump shows at several stages
        if why := _refusal(stage, kept, limits, share):
            if elsewhere:
                outcome.notes.append(f"{instance.name} on {instance.target} is not certain at the {stage.label}: {why}")
                continue
            refused[candidate.label] = outcome.refused[candidate.key] = why
            outcome.notes.append(
                f"{candidate.effect.name} on {candidate.target} is not named: {why} (its share of the gap: {share:.1%})"
            )
            adjusted.append(candidate)
            continue
        if elsewhere:
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
        if _is_named(candidate, outcome):
            continue
        values = result.fit.values_of(candidate)
        outcome.repaired = outcome.repaired.with_effect(candidate.instance(values))
        outcome.adjusted[candidate.key] = candidate
    known = _uncertainty(result.stage_fit.decision.model, outcome.repaired)
    outcome.repaired = outcome.repaired.with_uncertainty(known) if known.places else outcome.repaired
    return refused


def _is_named(candidate: Candidate, outcome: ProofOutcome) -> bool:
    """Whether an effect has its name already, from another stage."""
    others = {(candidate.effect.name, candidate.target), *candidate.aliases}
    return bool(others & {(e.name, e.target) for e in outcome.named if e.side == candidate.side})


def _refusal(stage: Stage, kept: AcceptedEffect, limits: Array, share: float) -> Reason | None:
    """Condition for a name that an effect of the decision fails by its proof; None if it fails none."""
    result = stage.found
    if share < _least_share(result):
        return Reason.LOST
    if may_be_absent(result, kept.candidate, limits):
        return Reason.UNCERTAIN
    # Slow errors accumulate beyond a block; friction and payloads are smooth functions of speed and posture, which the
    # discrepancy replaces, without their values.
    if result.problem.kind.integrates or result.problem.kind.is_force:
        return None
    assert result.stage_fit is not None
    less = result.stage_fit.dropped[kept.candidate.label]
    return None if clearly_worse(less, result.stage_fit.decision.model) else Reason.LOST


def _least_share(result: StageResult) -> float:
    """Least share of the closable gap of a name."""
    assert result.stage_fit is not None
    return result.problem.kind.least_share(result.stage_fit.decision.exact)


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


def _share(stage: Stage, candidate: Candidate) -> float:
    """Closed share of the held-out stage gap that is lost when the effect is dropped and the rest refitted."""
    fitted = stage.found.stage_fit
    assert fitted is not None
    dropped = fitted.dropped[candidate.label]
    excited = is_excited(stage, dropped.theta, stage.found.fit.theta)
    recordings = stage.split.held_out if excited else stage.split.seen
    first, framed = stage.theta, fitted.framed
    if (
        framed is not None
        and candidate.target not in ("base", "ee")
        and any(c.target == "base" for c in fitted.decision.model.candidates)
    ):
        first = framed.theta  # the frame closes most of the gap of a pose set
    before, after, less = (relative_error(stage, theta, recordings) for theta in (first, stage.found.fit.theta, dropped.theta))
    return float(np.clip((less - after) / (before - 1.0), 0.0, 1.0)) if before > 1.0 else 0.0


def with_carried(gap: Gap, outcome: ProofOutcome) -> Gap:
    """The gap by stage, with the accepted residual networks in ``after``."""
    accepted = [item for item in outcome.carried if item.accepted]
    after = {**gap.after, **{item.signal: item.after for item in accepted}}
    return replace(gap, after=after, noise_floor={**gap.noise_floor, **{item.signal: item.noise_floor for item in accepted}})
