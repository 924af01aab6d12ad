"""The list of cases: hidden effects with their magnitudes, machine, excitation and noise of each.

A case follows from its group, its number and the seed of the calibration; only the counts of each group, and that each effect
comes as often as any other, are the same for every seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from hidden.kinds import KNOWN, UNKNOWN, Kind
from hidden.machines import VARIANTS, Family

T = TypeVar("T")
Group = Literal["none", "single", "double", "triple", "unknown"]
Tier = Literal["smoke", "quick", "full"]
GROUPS: tuple[Group, ...] = ("none", "single", "double", "triple", "unknown")
#: Cases of each group by tier; a tier holds the cases of the ones below it, so that nothing is run twice.
COUNTS: dict[Tier, dict[Group, int]] = {
    "smoke": {"none": 3, "single": 5, "double": 1, "triple": 1, "unknown": 2},
    "quick": {"none": 20, "single": 26, "double": 6, "triple": 3, "unknown": 5},
    "full": {"none": 300, "single": 220, "double": 60, "triple": 40, "unknown": 40},
}
#: Magnitudes as multiples of the detection limit; most are at three and more, where a name is due.
FACTORS = (3.0, 10.0, 5.0, 3.0, 7.0, 10.0, 2.0, 4.0, 5.0, 1.0)
#: Families of the cases that hide nothing, and of those that hide several things.
FAMILIES: tuple[Family, ...] = ("valve_crane", "hydraulic_crane", "valve_crane", "servo_arm", "valve_crane", "slide")
NOISES = (1.0, 0.5, 2.0, 1.0, 4.0)
DISTURBANCES = (0.0, 0.001, 0.0, 0.003, 0.0, 0.01)


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: its kind, its magnitude in detection limits, and its direction."""

    kind: str
    factor: float
    direction: int


@dataclass(frozen=True)
class CaseSpec:
    """A case before it is made. ``noise`` is a multiple of the usual, ``disturbance`` the relative flow disturbance.

    ``family`` names the machine and ``variant`` which of its kind; ``seed`` is that of its own recordings.
    """

    name: str
    group: Group
    family: str
    variant: int
    hidden: tuple[Hidden, ...]
    excitation: str
    noise: float
    disturbance: float
    seed: int

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def from_json(values: dict[str, Any]) -> CaseSpec:
        return CaseSpec(**{**values, "hidden": tuple(Hidden(**each) for each in values["hidden"])})


def cases_of(tier: Tier, seed: int, only: Group | None = None) -> list[CaseSpec]:
    """The cases of a tier, of one group if that is given."""
    return cases_by_group(COUNTS[tier], case, seed, only)


def cases_by_group(
    counts: Mapping[Group, int], make: Callable[[Group, int, int], CaseSpec], seed: int, only: Group | None
) -> list[CaseSpec]:
    """``counts`` cases of each group, or of one group, by group, number and seed."""
    return [make(group, number, seed) for group, count in counts.items() if only in (None, group) for number in range(count)]


def case(group: Group, number: int, seed: int) -> CaseSpec:
    """Case ``number`` of a group in the calibration with this seed."""
    draw = np.random.default_rng([seed, GROUPS.index(group), number])
    several = "hydraulic_crane" if number % 4 == 3 else "valve_crane"
    kinds = kinds_of(group, number, seed, draw, KNOWN, UNKNOWN, several)
    family = kinds[0].family if kinds else FAMILIES[number % len(FAMILIES)]
    shared = sorted(set(range(VARIANTS)).intersection(*(kind.variants for kind in kinds)))
    hidden = tuple(Hidden(kind.key, _factor(group, number, k), int(draw.choice([-1, 1]))) for k, kind in enumerate(kinds))
    return CaseSpec(
        f"{group}-{number:03d}",
        group,
        family,
        int(draw.choice(shared)),
        hidden,
        _excitation(number, kinds, family),
        NOISES[number % len(NOISES)],
        DISTURBANCES[(number + number // len(FAMILIES)) % len(DISTURBANCES)] if family == "valve_crane" else 0.0,
        int(draw.integers(1, 2**31 - 100)),
    )


def _factor(group: Group, number: int, place: int) -> float:
    if group == "single":
        return FACTORS[number % len(FACTORS)]
    # Several effects, or one without a name, are well above their detection limits.
    return (4.0, 8.0, 5.0, 10.0, 6.0)[(number + 2 * place) % 5]


def _excitation(number: int, kinds: tuple[Kind, ...], family: str) -> str:
    special = [kind.excitation for kind in kinds if kind.excitation != "rich"]
    if special:
        return special[0]
    if number % 10 == 7:
        return "poor"
    return "flight" if number % 10 in (3, 9) and family in ("valve_crane", "hydraulic_crane") else "rich"


def kinds_of(
    group: Group, number: int, seed: int, draw: np.random.Generator, known: Sequence[Kind], unknown: Sequence[Kind], family: str
) -> tuple[Kind, ...]:
    """What case ``number`` of a group hides.

    Args:
        known, unknown: kinds with and without a name.
        family: of the machines with several hidden effects.
    """
    if group == "none":
        return ()
    if group == "unknown":
        return (in_order(unknown, seed)[number % len(unknown)],)
    if group == "single":
        return (turned(known, number, seed),)
    several = [kind for kind in known if kind.family == family]
    count = {"double": 2, "triple": 3}[group]
    while True:
        chosen = [several[k] for k in draw.choice(len(several), count, replace=False)]
        if apart(chosen):
            return tuple(chosen)


def apart(kinds: Sequence[Kind]) -> bool:
    """Whether kinds can be combined: different stages and targets, a common variant, one set of recordings."""
    places = {(kind.stage, kind.target) for kind in kinds}
    named = {name for kind in kinds for name in kind.named}
    shared = set(range(VARIANTS)).intersection(*(kind.variants for kind in kinds))
    programs = {kind.excitation for kind in kinds} - {"rich"}
    one_build = sum(kind.stage == "end_effector" for kind in kinds) < 2
    return len(places) == len(kinds) == len(named) and bool(shared) and len(programs) < 2 and one_build


def turned(known: Sequence[Kind], number: int, seed: int) -> Kind:
    """Effects in turn, so that each comes as often as any other; its places in turn as well."""
    effects = in_order(sorted({kind.named[0][0] for kind in known}), seed)
    effect = effects[number % len(effects)]
    places = in_order([kind for kind in known if kind.named[0][0] == effect], seed)
    return places[number // len(effects) % len(places)]


def in_order(items: Sequence[T], seed: int) -> list[T]:
    """Items in an order that the seed determines."""
    order = np.random.default_rng([seed, len(items)]).permutation(len(items))
    return [items[k] for k in order]


def listed(specs: Sequence[CaseSpec]) -> Iterator[str]:
    """One line a case, for people."""
    for spec in specs:
        hides = ", ".join(f"{each.kind.partition(':')[2]} × {each.factor:g}" for each in spec.hidden) or "nothing"
        noise = f"noise {spec.noise:g}, disturbance {100.0 * spec.disturbance:g} %"
        yield f"{spec.name:12s} {spec.family:15s} {spec.variant} {spec.excitation:8s} {noise}: {hides}"
