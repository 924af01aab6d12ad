"""Promotion policy of networks: conditions in TOML, limits with units (``docs/guide/models.md``).

Candidate and champion are evaluated on the held-out rows of one dataset version, the candidate's. The champion may have been
fitted to some of them, which favours it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal, get_args

from sysid.config import Strict, load_settings
from sysid.display import quantity
from sysid.errors import InputError, SettingsError, nearest
from sysid.figures import output_name
from sysid.registry import NETWORKS
from sysid.registry.promotion import Check
from sysid.units import si_factor
from sysid.validate import OutputReport, ValidationReport

Figure = Literal["rmse", "max", "p50", "p95", "p99", "bias"]
FIGURES: tuple[Figure, ...] = get_args(Figure)

_QUANTITY = re.compile(r"\s*([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(\S.*?)\s*")


@dataclass(frozen=True)
class Limit(Strict):
    """Upper limits of an output's figures, each with its unit (``"15 mm"``), on rows of one kind or of both."""

    rmse: str | float | None = None
    max: str | float | None = None
    p50: str | float | None = None
    p95: str | float | None = None
    p99: str | float | None = None
    bias: str | float | None = None
    rows: Literal["motion", "poses"] | None = None

    def figures(self) -> dict[Figure, str | float]:
        given = {name: getattr(self, name) for name in FIGURES}
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class KindPolicy(Strict):
    """Rules for networks of one kind.

    Args:
        not_worse: figures in which no output may be worse than with the champion.
        margin: relative increase that is not yet worse.
        baselines: whether no output may have a larger RMSE than the best simple model fitted on the same rows.
        limits: output, or pattern of outputs (``ee.*``) → its limit.
    """

    not_worse: tuple[Figure, ...] = ("rmse", "p95")
    margin: float = 0.05
    baselines: bool = False
    limits: dict[str, Limit] = field(default_factory=dict)


@dataclass(frozen=True)
class PromotionPolicy(Strict):
    """The whole policy; default: RMSE and 95 % error at most 5 % larger than the champion's."""

    schema: Literal[1] = 1
    actuator: KindPolicy = KindPolicy()
    forward: KindPolicy = KindPolicy()
    history: KindPolicy = KindPolicy()
    motion: KindPolicy = KindPolicy()

    def of(self, kind: str) -> KindPolicy:
        found: KindPolicy = getattr(self, kind)
        return found


def load_policy(path: Path | None = None) -> PromotionPolicy:
    """The policy in ``path``; None: the default.

    Raises:
        SettingsError: unknown keys, wrong types, a limit that is not a positive number with a unit.
    """
    if path is None:
        return PromotionPolicy()
    policy = load_settings(path, PromotionPolicy)
    for kind in NETWORKS:
        part = policy.of(kind)
        if not (math.isfinite(part.margin) and part.margin >= 0.0):
            raise SettingsError(f"{path}: {kind}.margin", str(part.margin), "a share from 0 on, as in 0.05")
        for pattern, limit in part.limits.items():
            where = f"{path}: {kind}.limits.{pattern!r}"
            if not limit.figures():
                raise SettingsError(where, "no figure", f"at least one of {', '.join(FIGURES)}")
            for figure, value in limit.figures().items():
                _quantity(value, f"{where}.{figure}")
    return policy


def policy_checks(
    policy: PromotionPolicy, report: ValidationReport, champion: ValidationReport | None = None, where: object = "policy"
) -> tuple[Check, ...]:
    """The result of each condition of the policy.

    Args:
        report: of the candidate.
        champion: report of the champion on the same rows; None if there is none.
        where: the policy's file, for messages.

    Raises:
        SettingsError: a limit for an output that the network does not have, or in a unit of another dimension.
    """
    part = policy.of(report.kind)
    checks = list(_limits(part, report, f"{where}: {report.kind}.limits"))
    if part.baselines:
        checks += [_baseline(entry, part.margin) for entry in report.outputs]
    if part.not_worse:
        checks += _against(part, report, champion)
    if not checks:
        raise SettingsError(f"{where}: {report.kind}", "no condition", "limits, not_worse or baselines")
    return tuple(checks)


def _limits(part: KindPolicy, report: ValidationReport, where: str) -> Iterator[Check]:
    for pattern, limit in part.limits.items():
        named = [entry for entry in report.outputs if fnmatchcase(entry.output, pattern)]
        entries = [entry for entry in named if limit.rows in (None, entry.rows)]
        if not named:
            raise SettingsError(f"{where}.{pattern!r}", "no such output", nearest(pattern, {e.output for e in report.outputs}))
        if not entries:
            there = ", ".join(sorted({entry.rows for entry in named}))
            raise SettingsError(f"{where}.{pattern!r}: rows", f"no held-out {limit.rows} of it", f"{there}, or none named")
        for figure, text in limit.figures().items():
            most, unit = _quantity(text, f"{where}.{pattern!r}.{figure}")
            for entry in entries:
                if unit != entry.unit:
                    example = "'5 mm'" if entry.unit == "m" else "'5 mrad'"
                    raise SettingsError(
                        f"{where}.{pattern!r}.{figure}", repr(text), f"a quantity in {entry.unit}, as in {example}"
                    )
                yield _limit(entry, figure, most)


def _limit(entry: OutputReport, figure: Figure, most: float) -> Check:
    value = _figure(entry, figure)
    what = f"{output_name(entry)}: {figure} {quantity(value, entry.unit)}"
    name = f"limit on {figure} of {output_name(entry)}"
    if value <= most:
        return Check(name, "passed", f"{what}, at most {quantity(most, entry.unit)} allowed")
    return Check(name, "failed", f"{what}, {quantity(value - most, entry.unit)} above the {quantity(most, entry.unit)} allowed")


def _baseline(entry: OutputReport, margin: float) -> Check:
    name = f"simple models of {output_name(entry)}"
    if not entry.baselines:
        return Check(name, "left out", f"{output_name(entry)}: no simple model to compare with")
    title, best = min(entry.baselines.items(), key=lambda item: item[1].rmse)
    ours, theirs = entry.metrics.rmse, best.rmse
    what = f"{output_name(entry)}: rmse {quantity(ours, entry.unit)}"
    text = f"{what}, {_compared(ours, theirs)} the {quantity(theirs, entry.unit)} of the best simple model ({title})"
    return _within_margin(name, ours, theirs, margin, text)


def _against(part: KindPolicy, report: ValidationReport, champion: ValidationReport | None) -> list[Check]:
    if champion is None:
        return [Check("champion", "left out", "nothing of this name was promoted before")]
    theirs = {(entry.output, entry.rows): entry for entry in champion.outputs}
    ours = {(entry.output, entry.rows): entry for entry in report.outputs}
    checks = []
    for key, entry in ours.items():
        if key not in theirs:
            text = f"{output_name(entry)}: {champion.model} does not predict it"
            checks.append(Check(f"champion in {output_name(entry)}", "left out", text))
            continue
        checks += [_figure_against(entry, theirs[key], figure, part.margin, champion.model) for figure in part.not_worse]
    for key, entry in theirs.items():
        if key not in ours:
            text = f"{output_name(entry)}: {champion.model} predicts it, this version does not"
            checks.append(Check(f"champion in {output_name(entry)}", "failed", text))
    return checks


def _figure_against(ours: OutputReport, theirs: OutputReport, figure: Figure, margin: float, champion: str) -> Check:
    mine, other = _figure(ours, figure), _figure(theirs, figure)
    name = f"champion in {figure} of {output_name(ours)}"
    what = f"{output_name(ours)}: {figure} {quantity(mine, ours.unit)}"
    text = f"{what}, {_compared(mine, other)} the {quantity(other, ours.unit)} of {champion}"
    return _within_margin(name, mine, other, margin, text)


def _within_margin(name: str, value: float, other: float, margin: float, text: str) -> Check:
    if value <= other * (1.0 + margin):
        return Check(name, "passed", text)
    return Check(name, "failed", f"{text}; {100.0 * margin:g} % allowed")


def _compared(value: float, other: float) -> str:
    """The relative difference of a figure from another, as ``12.3 % above``."""
    if value == other or other == 0.0:
        return "the same as" if value == other else "above"
    return f"{100.0 * abs(value / other - 1.0):.1f} % {'above' if value > other else 'below'}"


def _figure(entry: OutputReport, figure: Figure) -> float:
    return abs(float(getattr(entry.metrics, figure)))


def _quantity(value: str | float, where: str) -> tuple[float, str]:
    """``"15 mm"`` → ``(0.015, "m")``."""
    match = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    try:
        number = float(match[1]) if match is not None else math.nan
    except ValueError:
        number = math.nan
    if match is None or not (math.isfinite(number) and number > 0.0):
        raise SettingsError(where, repr(value), "a positive number with its unit, as in '15 mm'")
    try:
        factor, unit = si_factor(match[2], where)
    except InputError as error:
        raise SettingsError(where, error.found, error.expected) from None
    return factor * number, unit


def evaluated_by(policy: PromotionPolicy, kind: str, path: Path | None, dataset: str) -> Mapping[str, Any]:
    """The basis of a decision, for its record."""
    part = policy.of(kind)
    limits = {
        pattern: {key: value for key, value in asdict(limit).items() if value is not None}
        for pattern, limit in part.limits.items()
    }
    name = path.name if path is not None else "default"
    return {"by": "policy", "policy": name, "rules": {**asdict(part), "limits": limits}, "dataset": dataset}
