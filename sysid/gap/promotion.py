"""When a stored repair becomes what its name alone means: only when the proof on held-out recordings passes.

A repair is promoted where

1. it names what it repairs: every effect in it has a name, no placeholder for several that tie (a requested residual network
   is marked as what it is);
2. the held-out gap of every stage at which something was named falls;
3. the free-run gap of no held-out signal grows, and none is worse than that of the version promoted until now: by more than
   three standard deviations of what sensor noise alone makes of that signal's gap, counted from the noise floor upwards;
4. none grows in the PyBullet world beyond what the compiled plant accounts for. A world that cannot be had is not asked.

Nothing is deleted and nothing overwritten: the version before stays, and :meth:`sysid.registry.Registry.promote` sets it back.
The decision is :func:`sysid.registry.decide`, which records it with the version.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sysid.errors import StoreError
from sysid.gap.result import Gap, WorldGap
from sysid.registry import Check, ModelVersion, PromotionDecision, Registry
from sysid.registry.decision import now_ms

#: A gap has grown if it exceeds this many standard deviations of the noise floor.
SURE = 3.0
#: The held-out gap of a stage at which something was named has to fall below this multiple of what it was.
FALLS = 0.98
#: By how much the world may differ from the compiled plant: coordinates of tip and tool [m] (``docs/world.md``).
WORLD_AWAY = {"ee": 1e-6, "tool": 1e-3}


def names_check(named: Sequence[str], ties: Sequence[Sequence[tuple[str, str]]], carried: Sequence[str] = ()) -> Check:
    """Whether the repair consists of effects with a name.

    Args:
        carried: stages at which a residual network carries what has none, as it was asked to.
    """
    if ties:
        text = " / ".join(f"{name} on {target}" for name, target in ties[0])
        return Check("names", "failed", f"it holds a placeholder for effects that cannot be distinguished: {text}")
    if not named and not carried:
        return Check("names", "failed", "no effect was named: it only adjusts parameters too little for a name")
    return Check("names", "passed", ", ".join([*named, *(f"unnamed_residual at the {stage}" for stage in carried)]))


def stages_check(stages: Mapping[str, tuple[float, float]]) -> Check:
    """Whether every stage at which something was named is better.

    Args:
        stages: label of each → its held-out gap before and after, in noise floors.
    """
    failed = {label: gap for label, gap in stages.items() if not gap[1] < FALLS * gap[0]}
    shown = failed or stages
    text = "; ".join(f"{label} {before:.3g} → {after:.3g} noise floors" for label, (before, after) in shown.items())
    return Check("stages", "failed" if failed else "passed", f"does not fall: {text}" if failed else text)


def free_run_check(
    gap: Gap, spread: Mapping[str, float], units: Mapping[str, str], name: str = "free run", against: str = "before"
) -> Check:
    """Whether no signal is further off in the free run of the whole chain than ``against``.

    Args:
        gap: its ``before`` is what is compared with.
        spread: standard deviation by signal of the gap that the true model would have; what has none must not grow at all.
        units: by signal, for the text.
    """
    grown = []
    for signal, before in gap.before.items():
        after, limit = gap.after[signal], _limit(signal, before, gap.noise_floor, spread)
        if after > limit:
            unit = _unit(units, signal)
            grown.append(f"{signal} {before:.3g} → {after:.3g}{unit} (at most {limit:.3g}{unit})")
    if grown:
        return Check(name, "failed", f"further off than {against}: {', '.join(grown)}")
    return Check(name, "passed", f"none of {len(gap.before)} held-out signals is further off than {against}")


def world_check(found: WorldGap | None, spread: Mapping[str, float], units: Mapping[str, str]) -> Check:
    """Whether nothing grows in the PyBullet world that the compiled plant does not account for.

    The two may differ as they are known to, or as they did before the repair.
    """
    if found is None or not found.recordings:
        return Check("world", "left out", "not run")
    grown = []
    for signal, before in found.world.before.items():
        after = found.world.after[signal]
        away = max(WORLD_AWAY.get(signal.rpartition(".")[0], 0.0), abs(before - found.compiled.before[signal]))
        allowed = found.compiled.after[signal] + away
        limit = max(_limit(signal, before, found.world.noise_floor, spread), allowed * (1.0 + 1e-6))
        if after > limit:
            compiled, unit = found.compiled.after[signal], _unit(units, signal)
            grown.append(f"{signal} {before:.3g} → {after:.3g}{unit} (compiled plant {compiled:.3g}{unit})")
    if grown:
        return Check("world", "failed", f"further off in the PyBullet world only: {', '.join(grown)}")
    return Check("world", "passed", f"none of {len(found.world.before)} signals is further off in the PyBullet world")


def first_promotion(registry: Registry, version: str) -> ModelVersion:
    """What the name means before the first repair is evaluated: the promoted version, else from now on the questioned one."""
    name = version.partition("@")[0]
    until_now = registry.promoted(name)
    if until_now is None:
        try:
            judged = {"by": "sysid gap", "as": "questioned before any repair"}
            first = PromotionDecision(True, "", (), judged=judged, decided_ms=now_ms())
            return registry.promote(version, instead_of=None, decision=first)
        except StoreError:
            until_now = registry.promoted(name)
            if until_now is None:
                raise
    return until_now


def _unit(units: Mapping[str, str], signal: str) -> str:
    return f" {units[signal]}" if units.get(signal, "1") != "1" else ""


def _limit(signal: str, before: float, floor: Mapping[str, float], spread: Mapping[str, float]) -> float:
    """Beyond this a signal's gap has grown; rounding is no growth."""
    return max(before, floor.get(signal, 0.0)) * (1.0 + 1e-6) + SURE * spread.get(signal, 0.0)
