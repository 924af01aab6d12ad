"""Lineage and promotion of a stored repair: its name refers to it only if the proof on held-out recordings passes.

A repair is promoted if

1. it consists of named effects, without a placeholder for several that tie (a requested residual network is marked);
2. the held-out gap of every stage with a named effect falls;
3. the free-run gap of no held-out signal grows, and none is worse than that of the version promoted so far: by more than
   three standard deviations that sensor noise alone causes in that signal's gap, above the noise floor;
4. none grows in the PyBullet world beyond that of the compiled plant. If the world is not available, this is left out.

Nothing is deleted or overwritten: the version before remains, and :meth:`sysid.registry.Registry.promote` restores it.
The decision is :func:`sysid.registry.decide`, which records it with the version.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sysid.errors import StoreError
from sysid.extras import versions_of
from sysid.files import plain
from sysid.gap.prepare.case import Case
from sysid.gap.proof import ProofOutcome
from sysid.gap.result import Gap, WorldGap
from sysid.gap.written import with_units
from sysid.registry import Check, ModelVersion, PromotionDecision, Registry
from sysid.registry.promotion import now_ms
from sysid.release import __version__

#: A gap has grown if it exceeds its limit by this many standard deviations of the noise floor.
STANDARD_DEVIATIONS = 3.0
#: The held-out gap of a stage with a named effect has to fall below this multiple of its value before.
MAX_RATIO = 0.98
#: Allowed difference between the world and the compiled plant: coordinates of tip and tool [m] (``reports/bench_agreement/``).
WORLD_TOLERANCE = {"ee": 1e-6, "tool": 1e-3}

#: Packages that the results of the workflow depend on.
SOFTWARE = ("numpy", "scipy", "numba", "pandas", "arch")


def lineage_of(case: Case, outcome: ProofOutcome, gap: Gap, stage_gap: Gap, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Data, settings, evidence and software of a repair as JSON values: the same of a repeated run, and so no new version."""
    return plain(  # type: ignore[no-any-return]
        {
            "dataset_digest": case.dataset.digest,
            "recordings": {role: [r.name for r in getattr(case.split, role)] for role in ("fit", "select", "held_out")},
            "seed": case.seed,
            "settings": {**settings, "noise": dict(case.noise)},
            "named": [f"{e.name}({e.target})" for e in outcome.named],
            "effects": [
                {
                    "name": e.name,
                    "target": e.target,
                    "side": e.side,
                    "parameters": dict(e.parameters),
                    "units": dict(e.units),
                    "interval95": {key: list(ends) for key, ends in e.interval95.items()},
                    "closed_share": e.gap_share,
                    "evidence": asdict(e.evidence) if e.evidence is not None else None,
                }
                for e in with_units(outcome.named, case.dataset)
            ],
            "ties": outcome.ties,
            "unnamed_residual": [" of ".join(item.key) for item in outcome.repaired.residuals],
            "proof": {"gap": asdict(gap), "stage_gap": asdict(stage_gap)},
            "notes": outcome.notes,
            "software": {"sysid": __version__, "python": platform.python_version(), **versions_of(SOFTWARE)},
        }
    )


def names_check(named: Sequence[str], ties: Sequence[Sequence[tuple[str, str]]], carried: Sequence[str] = ()) -> Check:
    """Whether the repair consists of named effects.

    Args:
        carried: stages with a requested residual network.
    """
    if ties:
        text = " / ".join(f"{name} on {target}" for name, target in ties[0])
        return Check("names", "failed", f"it holds a placeholder for effects that cannot be distinguished: {text}")
    if not named and not carried:
        return Check("names", "failed", "no effect was named: it only adjusts parameters")
    return Check("names", "passed", ", ".join([*named, *(f"unnamed_residual at the {stage}" for stage in carried)]))


def stages_check(stages: Mapping[str, tuple[float, float]]) -> Check:
    """Whether every stage with a named effect is better.

    Args:
        stages: label of each → its held-out gap before and after, in noise floors.
    """
    failed = {label: gap for label, gap in stages.items() if not gap[1] < MAX_RATIO * gap[0]}
    shown = failed or stages
    text = "; ".join(f"{label} {before:.3g} → {after:.3g} noise floors" for label, (before, after) in shown.items())
    return Check("stages", "failed" if failed else "passed", f"does not fall: {text}" if failed else text)


def free_run_check(
    gap: Gap, spread: Mapping[str, float], units: Mapping[str, str], name: str = "free run", against: str = "before"
) -> Check:
    """Whether no signal has a larger error in the free run of the whole chain than ``against``.

    Args:
        gap: its ``before`` is the reference.
        spread: standard deviation by signal of the gap of the true model; a signal without one must not grow at all.
        units: by signal, for the text.
    """
    grown = []
    for signal, before in gap.before.items():
        after, limit = gap.after[signal], _limit(signal, before, gap.noise_floor, spread)
        if after > limit:
            unit = _unit(units, signal)
            grown.append(f"{signal} {before:.3g} → {after:.3g}{unit} (at most {limit:.3g}{unit})")
    if grown:
        return Check(name, "failed", f"larger error than {against}: {', '.join(grown)}")
    return Check(name, "passed", f"none of {len(gap.before)} held-out signals has a larger error than {against}")


def world_check(found: WorldGap | None, spread: Mapping[str, float], units: Mapping[str, str]) -> Check:
    """Whether no gap grows in the PyBullet world beyond that of the compiled plant.

    The two may differ by their tolerance, or by as much as before the repair.
    """
    if found is None or not found.recordings:
        return Check("world", "left out", "not run")
    grown = []
    for signal, before in found.world.before.items():
        after = found.world.after[signal]
        away = max(WORLD_TOLERANCE.get(signal.rpartition(".")[0], 0.0), abs(before - found.compiled.before[signal]))
        allowed = found.compiled.after[signal] + away
        limit = max(_limit(signal, before, found.world.noise_floor, spread), allowed * (1.0 + 1e-6))
        if after > limit:
            compiled, unit = found.compiled.after[signal], _unit(units, signal)
            grown.append(f"{signal} {before:.3g} → {after:.3g}{unit} (compiled plant {compiled:.3g}{unit})")
    if grown:
        return Check("world", "failed", f"larger error in the PyBullet world only: {', '.join(grown)}")
    return Check("world", "passed", f"none of {len(found.world.before)} signals has a larger error in the PyBullet world")


def first_promotion(registry: Registry, version: str) -> ModelVersion:
    """The promoted version before the first repair is evaluated; if there is none, the plant under test is promoted."""
    name = version.partition("@")[0]
    until_now = registry.promoted(name)
    if until_now is not None:
        return until_now
    first = PromotionDecision(
        True, "", (), judged={"by": "sysid gap", "as": "questioned before any repair"}, decided_ms=now_ms()
    )
    try:
        return registry.promote(version, instead_of=None, decision=first)
    except StoreError:
        until_now = registry.promoted(name)  # another process may have been first
        if until_now is None:
            raise
        return until_now


def _unit(units: Mapping[str, str], signal: str) -> str:
    return f" {units[signal]}" if units.get(signal, "1") != "1" else ""


def _limit(signal: str, before: float, floor: Mapping[str, float], spread: Mapping[str, float]) -> float:
    """Limit beyond which a signal's gap has grown, rounding aside."""
    return max(before, floor.get(signal, 0.0)) * (1.0 + 1e-6) + STANDARD_DEVIATIONS * spread.get(signal, 0.0)
