"""The list of 200 cases of MuJoCo and PyBullet, drawn from the seed like those of `simulated_bench`."""

from __future__ import annotations

import numpy as np

from hidden.cases import GROUPS, CaseSpec, Group, Hidden, Tier, cases_by_group, kinds_of
from hidden.foreign.kinds import KNOWN, UNKNOWN
from hidden.foreign.machines import VARIANTS, Family

#: Cases of each group by tier; a tier holds the cases of the ones below it.
COUNTS: dict[Tier, dict[Group, int]] = {
    "smoke": {"none": 3, "single": 4, "double": 1, "triple": 1, "unknown": 2},
    "quick": {"none": 15, "single": 20, "double": 5, "triple": 3, "unknown": 6},
    "full": {"none": 60, "single": 80, "double": 24, "triple": 12, "unknown": 24},
}
#: Magnitudes as multiples of the detection limit, and those of several at once or of what has no name.
FACTORS, SEVERAL = (3.0, 10.0, 5.0), (5.0, 10.0, 4.0, 8.0)
#: Families of the cases that hide nothing.
FAMILIES: tuple[Family, ...] = (
    "mujoco_crane", "mujoco_arm", "mujoco_crane", "mujoco_slide", "bullet_arm", "mujoco_crane", "bullet_lever",
)  # fmt: skip
NOISES = (1.0, 0.5, 2.0, 1.0)
#: Excitations: every program, an operator only, every program with recordings that begin in motion, three short recordings.
EXCITATIONS = ("rich", "moving", "rich", "operator", "moving", "rich", "rich", "moving", "rich", "poor")


def cases_of(tier: Tier, seed: int, only: Group | None = None) -> list[CaseSpec]:
    """The cases of a tier, of one group if that is given."""
    return cases_by_group(COUNTS[tier], case, seed, only)


def case(group: Group, number: int, seed: int) -> CaseSpec:
    """Case ``number`` of a group in the calibration with this seed."""
    draw = np.random.default_rng([seed, 7, GROUPS.index(group), number])
    kinds = kinds_of(group, number, seed, draw, KNOWN, UNKNOWN, "mujoco_crane")
    shared = sorted(set(range(VARIANTS)).intersection(*(kind.variants for kind in kinds)))
    factors = [FACTORS[number % 3] if group == "single" else SEVERAL[(number + 3 * k) % 4] for k in range(len(kinds))]
    return CaseSpec(
        f"{group}-{number:03d}",
        group,
        kinds[0].family if kinds else FAMILIES[number % len(FAMILIES)],
        int(draw.choice(shared)),
        tuple(Hidden(kind.key, factor, int(draw.choice([-1, 1]))) for kind, factor in zip(kinds, factors, strict=True)),
        EXCITATIONS[(number + number // len(EXCITATIONS)) % len(EXCITATIONS)],
        NOISES[(number // 3) % len(NOISES)],
        0.0,
        int(draw.integers(1, 2**31 - 10_000)),
    )
