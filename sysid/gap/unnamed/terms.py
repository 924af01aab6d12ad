"""Terms of a residual formula: factors of measured variables, terms as products of factors, formulas as sums of terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import numpy.typing as npt

from sysid.gap.unnamed.residual_series import ResidualSeries

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Factor:
    """One factor of a term: a ``function`` of a measured variable, with its ``number`` (centre, time constant or period)."""

    function: str
    variable: str
    number: float = 0.0

    def values(self, series: ResidualSeries) -> Array:
        return _FUNCTIONS[self.function](series.variables[self.variable], self.number)

    def __str__(self) -> str:
        return _factor_text(self)


@dataclass(frozen=True)
class Term:
    """A product of factors; none is a constant."""

    factors: tuple[Factor, ...] = ()

    def column(self, series: ResidualSeries) -> Array:
        """Its contribution to the target, (m,)."""
        return series.filtered(self.values(series))

    def values(self, series: ResidualSeries) -> Array:
        """Values at the parts of the bins."""
        out = np.ones(len(next(iter(series.variables.values()))))
        for factor in self.factors:
            out = out * factor.values(series)
        return out

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(f.variable for f in self.factors))

    @property
    def periodic(self) -> Factor | None:
        """The sine or cosine factor; None where the term is not periodic."""
        return next((f for f in self.factors if f.function in ("sin", "cos")), None)

    @property
    def group(self) -> tuple[Factor, ...]:
        """Key of the group of the term: sine and cosine of one ripple form one group."""
        return tuple(Factor("periodic", f.variable, f.number) if f.function in ("sin", "cos") else f for f in self.factors)

    def __str__(self) -> str:
        return "·".join(map(str, self.factors))


@dataclass(frozen=True)
class Formula:
    """A sum of terms and a constant.

    Args:
        coefficients: one for each of ``terms``.
    """

    terms: tuple[Term, ...] = ()
    coefficients: tuple[float, ...] = ()
    constant: float = 0.0

    def predict(self, series: ResidualSeries) -> Array:
        """(m,)"""
        out = np.full(len(series.target), self.constant)
        for coefficient, term in zip(self.coefficients, self.terms, strict=True):
            out += coefficient * term.column(series)
        return out

    def __str__(self) -> str:
        parts = []
        pairs = zip(self.terms, self.coefficients, strict=True)
        for _, members in groupby(pairs, key=lambda pair: pair[0].group):
            listed = list(members)
            periodic = listed[0][0].periodic
            if periodic is None:
                parts.append((listed[0][1], str(listed[0][0])))
                continue
            sizes = {term.periodic.function: c for term, c in listed if term.periodic is not None}
            sine, cosine = sizes.get("sin", 0.0), sizes.get("cos", 0.0)
            size, phase = np.hypot(sine, cosine), np.arctan2(cosine, sine)
            rest = [str(f) for f in listed[0][0].factors if f is not periodic]
            sine_text = f"sin(2π·{periodic.variable}/{periodic.number:.4g} {'+' if phase >= 0.0 else '−'} {abs(phase):.2f})"
            parts.append((float(size), "·".join([sine_text, *rest])))
        out = ""
        for k, (value, text) in enumerate(parts):
            sign = ("−" if value < 0.0 else "") if k == 0 else (" − " if value < 0.0 else " + ")
            out += f"{sign}{abs(value):.3g}·{text}"
        return out


def modulations(blocks: Sequence[ResidualSeries]) -> list[tuple[Factor, ...]]:
    """Factors by which the amplitude of a ripple may be modulated, of variables that all blocks have."""
    if not blocks[0].rate:
        return [()]
    shared = [name for name in blocks[0].variables if all(name in block.variables for block in blocks)]
    directions = [name for name in shared if name.startswith("direction of ")]
    speeds = [name.replace("direction", "speed", 1) for name in directions[:1]]
    moving = [(Factor("abs", name),) for name in directions[:1]]
    return [(), *moving, *((Factor(function, name),) for name in speeds for function in ("identity", "abs"))]


_FUNCTIONS: dict[str, Callable[[Array, float], Array]] = {
    "identity": lambda x, _: x,
    "abs": lambda x, _: np.abs(x),
    "square": lambda x, _: x * x,
    "signed square": lambda x, _: x * np.abs(x),
    "cube": lambda x, _: x**3,
    "offset": lambda x, centre: x - centre,
    "offset square": lambda x, centre: (x - centre) ** 2,
    "decay": lambda x, seconds: np.exp(-x / seconds),
    "sin": lambda x, period: np.sin(2.0 * np.pi * x / period),
    "cos": lambda x, period: np.cos(2.0 * np.pi * x / period),
}


def _factor_text(factor: Factor) -> str:
    name, offset = factor.variable, f"({factor.variable} {'−' if factor.number >= 0.0 else '+'} {abs(factor.number):g})"
    if factor.number == 0.0 and factor.function.startswith("offset"):
        offset = name if factor.function == "offset" else f"({name})"
    return {
        "identity": name,
        "abs": f"|{name}|",
        "square": f"({name})²",
        "signed square": f"{name}·|{name}|",
        "cube": f"({name})³",
        "offset": offset,
        "offset square": f"{offset}²",
        "decay": f"exp(−{name}/{factor.number:g} s)",
    }.get(factor.function, f"{factor.function}(2π·{name}/{factor.number:.4g})")
