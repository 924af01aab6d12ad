"""Figures of gap results and networks, as :mod:`sysid.figures` describes them; sentences about results, and what to record
next: those of console and report are the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from sysid.datasets.recording import Dataset
from sysid.display import NOTHING, decimals_for, fixed, percent, quantity, shown_unit
from sysid.effects import effect_named
from sysid.effects.units import parameter_unit
from sysid.figures import ErrorFigure, NetworkError, ParameterFigure, Table
from sysid.gap.arm.sag import advice_on_sag, sagging_axis
from sysid.gap.excitation import TRAVEL_UNITS, axis_of
from sysid.gap.result import Gap, GapResult, NamedEffect, ResidualModelResult, Unnamed
from sysid.machine import Machine
from sysid.names import listed
from sysid.reports.words import effect_place, effect_sentence, effect_title, owner_name, signal_name, tie_text, with_titles
from sysid.signals import POINTS
from sysid.validate import OutputReport, ValidationReport
from sysid.validate.error_analysis import Spike
from sysid.versions.diff import PredictionChange

_NONE: Mapping[str, Any] = {}


# -- errors of a simulation ---------------------------------------------------------------------------------------------


def signal_errors(gap: Gap, units: Mapping[str, str]) -> list[ErrorFigure]:
    """One figure for each measured signal; ``units``: signal → SI unit."""
    return [
        ErrorFigure(name, units.get(name, "1"), before, gap.after.get(name, math.nan), gap.noise_floor.get(name, math.nan))
        for name, before in gap.before.items()
    ]


def point_errors(gap: Gap, units: Mapping[str, str]) -> list[ErrorFigure]:
    """As :func:`signal_errors` with names in words; the coordinates of a point are combined to one distance."""
    groups: dict[str, list[ErrorFigure]] = {}
    for item in signal_errors(gap, units):
        owner = item.name.rpartition(".")[0]
        groups.setdefault(owner if owner in POINTS else item.name, []).append(item)
    found = []
    for name, own in groups.items():
        if name == own[0].name:
            found.append(replace(own[0], name=signal_name(name)))
        else:
            sizes = (math.hypot(*(getattr(item, when) for item in own)) for when in ("before", "after", "noise_floor"))
            found.append(ErrorFigure(f"{owner_name(name)} position", "m", *sizes))
    return found


def error_table(gap: Gap, units: Mapping[str, str]) -> Table:
    """The held-out error of every measured signal."""
    rows = [(item.name, *item.texts, percent(item.closed)) for item in signal_errors(gap, units)]
    return Table(("held-out error", "before", "after", "noise floor", "closed"), rows, (1, 2, 3, 4))


# -- parameters of effects ----------------------------------------------------------------------------------------------


def parameters_of(
    effect: str,
    target: str,
    values: Mapping[str, Any],
    machine: Machine,
    units: Mapping[str, str] = _NONE,
    intervals: Mapping[str, tuple[Any, Any]] = _NONE,
    before: Mapping[str, Any] = _NONE,
) -> list[ParameterFigure]:
    """The parameters of an effect on a machine.

    Args:
        values: parameter → value [SI]; ``intervals``: its 95 % interval; ``before``: the value that it replaces.
        units: signal → SI unit; a machine without a URDF may not state whether an axis is revolute.
    """
    return [
        ParameterFigure(
            key,
            parameter_unit(effect, key.partition("[")[0], target, machine, units),
            value,
            intervals.get(key),
            before.get(key),
        )
        for key, value in values.items()
    ]


def effect_figures(effect: NamedEffect, dataset: Dataset) -> list[ParameterFigure]:
    """The parameters of a named effect that recordings determine, with their intervals."""
    return parameters_of(effect.name, effect.target, effect.given, dataset.machine, dataset.units, effect.interval95)


def unnamed_sentence(item: Unnamed, machine: Machine) -> str:
    """An error of a stage that no effect explains, on one line."""
    return f"Unnamed: {item.stage} of {item.target}, depends on {item.depends_on}: {with_titles(item.form, machine)}"


def residual_sentence(item: ResidualModelResult, dataset: Dataset) -> str:
    """Held-out error of a stage without and with its residual network."""
    unit = dataset.units.get(item.signal) or dataset.machine.expected_unit(item.signal) or "1"
    before, after, floor = ErrorFigure(item.signal, unit, item.before, item.after, item.noise_floor).texts
    return (
        f"bounded residual network (unnamed_residual): {item.stage} of {item.target}, held-out error {before} → {after} "
        f"(noise floor {floor}). It is fitted to the recordings and has no physical cause."
    )


def named_sentence(effect: NamedEffect, gap: GapResult, dataset: Dataset) -> str:
    """One sentence about a named effect with its values."""
    found = parameters_of(effect.name, effect.target, effect.given, dataset.machine, dataset.units)
    texts = {parameter.name: parameter.text for parameter in found}
    return effect_sentence(effect.name, effect.target, texts, gap.names_on(effect.target), dataset.machine)


# -- what to record next ------------------------------------------------------------------------------------------------


def next_steps(result: GapResult, dataset: Dataset) -> list[str]:
    """One text for each recording to make; effects that the same motion excites are grouped over their axes."""
    machine, steps = dataset.machine, list[str]()
    for planned in result.experiments:
        effects = [effect for purpose in planned.purposes for effect in purpose.effects]
        places = listed(list(dict.fromkeys(effect_place(effect.name, effect.target, machine) for effect in effects)))
        again = f", {planned.repeats} times" if planned.repeats > 1 else ""
        steps.append(f"Record {planned.name}.toml ({planned.about}, {planned.seconds:.0f} s{again}): {places}.")
    sagging = [axis for tie in result.ambiguous if (axis := sagging_axis(tie, machine))]
    steps += [advice_on_sag(sagging)] if sagging else []
    for tie in (tie for tie in result.ambiguous if not sagging_axis(tie, machine)):
        motions = dict.fromkeys(effect_named(name).need.advice.format(axis=target) for name, target in tie)
        steps.append(f"{' '.join(motions)} These recordings cannot distinguish {tie_text(tie, machine)}.")
    still: dict[str, None] = {}
    groups: dict[tuple[str, str], dict[str, None]] = {}
    for item in result.excitation:
        if item.sufficient:
            continue
        axis = axis_of(item.target, machine) or item.target
        if item.unit in TRAVEL_UNITS:
            still[axis] = None
        else:
            key = effect_named(item.name).need.advice, effect_title(item.name, axis, machine)
            groups.setdefault(key, {})[item.target] = None
    if still:
        axes = listed(list(still))
        steps.append(f"Record {axes} moving over {'its range' if len(still) == 1 else 'their ranges'}: not moved so far.")
    by_motion: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for (motion, title), targets in groups.items():
        by_motion.setdefault((motion, tuple(targets)), []).append(title)
    for (motion, where), titles in sorted(by_motion.items(), key=lambda item: -len(item[0][1]) * len(item[1])):
        of = listed([titles[0], *(each[0].lower() + each[1:] for each in titles[1:])])
        steps.append(f"{motion.format(axis=listed(list(where)))} {of}: not enough motion so far.")
    return steps


# -- errors of networks -------------------------------------------------------------------------------------------------


def network_rows(
    report: ValidationReport, paper: Mapping[str, float] | None = None, spell: Callable[[str], str] = str
) -> Iterable[tuple[str, ...]]:
    """Output, kind of rows, RMSE, 95 %, maximum, [published maximum,] noise floor, unit, best simple model.

    All figures of a unit have the same decimals: two digits of the smallest error or noise floor.

    Args:
        paper: output → published maximum [SI].
        spell: of the name of an output.
    """
    entries = [network_error(entry) for entry in report.outputs]
    for entry in entries:
        factor, unit = shown_unit(entry.unit)
        same = [value for other in entries if other.unit == entry.unit for value in (other.rmse, other.noise_floor)]
        decimals = decimals_for(factor * value for value in same if value is not None)

        def text(value: float | None, factor: float = factor, decimals: int = decimals) -> str:
            return NOTHING if value is None else fixed(factor * value, decimals)

        best = entry.best_simple
        known = paper or {}
        published = [] if paper is None else [fixed(factor * known[entry.output], 2) if entry.output in known else ""]
        simple = f"{best} {text(entry.baselines[best])}" if best else NOTHING
        errors = (*map(text, (entry.rmse, entry.p95, entry.max)), *published, text(entry.noise_floor))
        yield (spell(entry.output), entry.rows, *errors, unit, simple)


def network_error(entry: OutputReport) -> NetworkError:
    """The errors of one output on held-out rows."""
    errors, simple = entry.metrics, {name: metrics.rmse for name, metrics in entry.baselines.items()}
    return NetworkError(entry.output, entry.rows, entry.unit, errors.rmse, errors.p95, errors.max, entry.noise_floor, simple)


def largest_spikes(report: ValidationReport) -> list[tuple[OutputReport, Spike]]:
    """The spikes of all outputs, the largest first."""
    found = [(entry, spike) for entry in report.outputs for spike in entry.spikes]
    return sorted(found, key=lambda pair: -pair[1].sigmas)


def spike_error(entry: OutputReport, spike: Spike) -> str:
    return quantity(spike.error, entry.unit, 2)


def cause(spike: Spike) -> str:
    return spike.cause.replace("_", " ")


def spike_sentence(entry: OutputReport, spike: Spike) -> str:
    """``boom.joint −0.12° at 3.21 s of sweep-01 (reversal)``."""
    return f"{entry.output} {spike_error(entry, spike)} at {spike.time:.2f} s of {spike.recording} ({cause(spike)})"


def prediction_cells(entry: PredictionChange) -> tuple[str, ...]:
    """Output, largest and RMS difference of two versions, and where it is the largest."""
    at = ", ".join(f"{signal} {value:.4g}" for signal, value in entry.at.items())
    where = at if entry.points else "the fitted ranges do not overlap"
    return entry.output, quantity(entry.largest, entry.unit), quantity(entry.rms, entry.unit), where


PREDICTIONS = ("output", "largest difference", "RMS", "largest at")
