"""Which parameters differ between the machines of a fleet.

Two levels of a random-effects model: recordings of a machine vary around its value, machines around the value of the type.

    y_mr = θ_m + b_mr + e_mr,    e_mr ~ N(0, s²_mr) with known s,    b_mr ~ N(0, σ²_m),    θ_m = μ + a_m,    a_m ~ N(0, τ²)

θ_m is the weighted mean over the recordings of a machine, with the between-recording variance of Paule and Mandel (J. Res. NBS
87 (1982), 377) and Student's t, as Hartung and Knapp (Stat. Med. 20 (2001), 3875) for few recordings. Whether the θ_m differ is
Welch's analysis of variance (Biometrika 38 (1951), 330), which allows a variance to each machine. Parameters are tested
together (Holm, Scand. J. Stat. 6 (1979), 65).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import optimize, stats
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.oneway import anova_generic

from sysid.fleet.effects import FleetEffect, ParameterHistory

Array = npt.NDArray[np.float64]

#: Probability of a false difference anywhere in the fleet.
LEVEL = 0.05
#: A machine with fewer recordings has no variance of its own.
LEAST_RECORDINGS = 2


@dataclass(frozen=True)
class MachineValue:
    """The value of a parameter on one machine: mean over its recordings, standard error, 95 % interval."""

    machine: str
    value: float
    error: float
    interval95: tuple[float, float]
    recordings: int


@dataclass(frozen=True)
class Difference:
    """One parameter over the machines of the fleet.

    Args:
        machines: those with at least :data:`LEAST_RECORDINGS` recordings that determine the parameter.
        mean: of the machines, weighted; ``between``: standard deviation τ of the machines around it.
        p_value: of equal machines, adjusted for the number of parameters; None for fewer than two machines.
        deviating: machines whose value certainly differs from that of most others by more than a negligible change.
        differs: the machines differ, significantly and by more than a negligible change.
    """

    effect: FleetEffect
    parameter: str
    unit: str
    negligible: float
    machines: tuple[MachineValue, ...]
    mean: float
    between: float
    p_value: float | None
    deviating: tuple[str, ...]
    differs: bool


def differences(histories: Sequence[ParameterHistory]) -> tuple[Difference, ...]:
    """Compare the machines, parameter by parameter; in the order in which the parameters first appear."""
    groups: dict[tuple[FleetEffect, str], list[ParameterHistory]] = {}
    for history in histories:
        groups.setdefault((history.effect, history.parameter), []).append(history)
    values = {key: [machine_value(h) for h in group if len(h.values) >= LEAST_RECORDINGS] for key, group in groups.items()}
    raw = {key: p_equal(machines) for key, machines in values.items() if len(machines) > 1}
    adjusted = dict(zip(raw, multipletests(list(raw.values()), LEVEL, "holm")[1].tolist(), strict=True)) if raw else {}
    return tuple(_difference(key, group[0], values[key], adjusted.get(key)) for key, group in groups.items())


def machine_value(history: ParameterHistory) -> MachineValue:
    """Mean of a parameter over the recordings of a machine, at least two."""
    values, variances = np.array(history.values), np.array(history.deviations) ** 2
    mean, error, _ = combined(values, variances)
    reach = float(stats.t.ppf(0.5 + 0.475, len(values) - 1)) * error
    return MachineValue(history.machine, mean, error, (mean - reach, mean + reach), len(values))


def combined(values: Array, variances: Array) -> tuple[float, float, float]:
    """Mean, standard error, and between-variance τ² of ``values`` (k,) with known ``variances`` (k,).

    τ² is the root of Σ (y − ȳ)²/(s² + τ²) = k − 1 (Paule and Mandel 1982), zero where the values scatter less than that. The
    function of statsmodels has an absolute tolerance, which is larger than τ² of most parameters.
    """
    scale = float(np.median(variances))

    def excess(tau2: float) -> float:
        weights = 1.0 / (variances / scale + tau2)
        mean = np.average(values, weights=weights)
        return float(weights @ (values - mean) ** 2) / scale - (len(values) - 1)

    tau2 = 0.0
    if excess(0.0) > 0.0:
        top = 1.0
        while excess(top) > 0.0:
            top *= 4.0
        tau2 = scale * float(optimize.brentq(excess, 0.0, top, xtol=1e-12))
    weights = 1.0 / (variances + tau2)
    return float(np.average(values, weights=weights)), float(weights.sum() ** -0.5), tau2


def p_equal(machines: Sequence[MachineValue]) -> float:
    """Probability of such differences between equal machines."""
    counts = np.array([m.recordings for m in machines])
    means, variances = np.array([m.value for m in machines]), np.array([m.error for m in machines]) ** 2 * counts
    return float(anova_generic(means, variances, counts, use_var="unequal").pvalue)


def _difference(
    key: tuple[FleetEffect, str], first: ParameterHistory, machines: Sequence[MachineValue], p_value: float | None
) -> Difference:
    effect, parameter = key
    mean, between = float("nan"), 0.0
    deviating: tuple[str, ...] = ()
    if len(machines) == 1:
        mean = machines[0].value
    elif machines:
        values, variances = np.array([m.value for m in machines]), np.array([m.error for m in machines]) ** 2
        mean, _, tau2 = combined(values, variances)
        between = tau2**0.5
    if p_value is not None and p_value < LEVEL:
        pairs = len(machines) * (len(machines) - 1) // 2
        level = LEVEL / pairs
        apart = {m.machine: sum(_apart(m, other, first.negligible, level) for other in machines) for m in machines}
        deviating = tuple(name for name, count in apart.items() if count > (len(machines) - 1) / 2)
    large = len(machines) > 1 and max(m.value for m in machines) - min(m.value for m in machines) > first.negligible
    differs = p_value is not None and p_value < LEVEL and large
    return Difference(
        effect, parameter, first.unit, first.negligible, tuple(machines), mean, between, p_value, deviating, differs
    )


def _apart(one: MachineValue, other: MachineValue, negligible: float, level: float) -> bool:
    """Whether two machines certainly differ by more than a negligible change (Welch's t-test)."""
    squares = one.error**2, other.error**2
    if one is other or sum(squares) == 0.0:
        return False
    free = sum(squares) ** 2 / (squares[0] ** 2 / (one.recordings - 1) + squares[1] ** 2 / (other.recordings - 1))
    return bool(abs(one.value - other.value) - stats.t.ppf(1.0 - 0.5 * level, free) * sum(squares) ** 0.5 > negligible)
