"""What a remainder may be made of: factors of what was measured, terms as their products, forms as sums of terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import numpy.typing as npt

from sysid.gap.unnamed.probes import Series

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Factor:
    """One part of a term: what is done (``how``) with a variable, and a number that belongs to it (centre or period)."""

    how: str
    variable: str
    number: float = 0.0

    def values(self, series: Series) -> Array:
        return _HOW[self.how](series.variables[self.variable], self.number)

    def __str__(self) -> str:
        return _words(self)


@dataclass(frozen=True)
class Term:
    """A product of factors; none is a constant."""

    factors: tuple[Factor, ...] = ()

    def column(self, series: Series) -> Array:
        """What it does to the target, (m,)."""
        return series.filtered(self.values(series))

    def values(self, series: Series) -> Array:
        """At the parts of the bins."""
        out = np.ones(len(next(iter(series.variables.values()))))
        for factor in self.factors:
            out = out * factor.values(series)
        return out

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(f.variable for f in self.factors))

    @property
    def wave(self) -> Factor | None:
        """The factor that repeats itself."""
        return next((f for f in self.factors if f.how in ("sin", "cos")), None)

    @property
    def group(self) -> tuple[Factor, ...]:
        """Sine and cosine of one ripple belong together."""
        return tuple(Factor("wave", f.variable, f.number) if f.how in ("sin", "cos") else f for f in self.factors)

    def __str__(self) -> str:
        return "·".join(map(str, self.factors))


@dataclass(frozen=True)
class Form:
    """A sum of terms and a constant.

    Args:
        coefficients: one for each of ``terms``.
    """

    terms: tuple[Term, ...] = ()
    coefficients: tuple[float, ...] = ()
    constant: float = 0.0

    def predict(self, series: Series) -> Array:
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
            wave = listed[0][0].wave
            if wave is None:
                parts.append((listed[0][1], str(listed[0][0])))
                continue
            sizes = {term.wave.how: c for term, c in listed if term.wave is not None}
            sine, cosine = sizes.get("sin", 0.0), sizes.get("cos", 0.0)
            size, phase = np.hypot(sine, cosine), np.arctan2(cosine, sine)
            rest = [str(f) for f in listed[0][0].factors if f is not wave]
            said = f"sin(2π·{wave.variable}/{wave.number:.4g} {'+' if phase >= 0.0 else '−'} {abs(phase):.2f})"
            parts.append((float(size), "·".join([said, *rest])))
        said = ""
        for k, (value, text) in enumerate(parts):
            sign = ("−" if value < 0.0 else "") if k == 0 else (" − " if value < 0.0 else " + ")
            said += f"{sign}{abs(value):.3g}·{text}"
        return said


def modulations(blocks: Sequence[Series]) -> list[tuple[Factor, ...]]:
    """What the size of a ripple may go with."""
    if not blocks[0].rate:
        return [()]
    ways = [name for name in blocks[0].variables if name.startswith("direction of ")]
    speeds = [name.replace("direction", "speed", 1) for name in ways[:1]]
    moving = [(Factor("abs", name),) for name in ways[:1]]
    return [(), *moving, *((Factor(how, name),) for name in speeds for how in ("is", "abs"))]


_HOW: dict[str, Callable[[Array, float], Array]] = {
    "is": lambda x, _: x,
    "abs": lambda x, _: np.abs(x),
    "square": lambda x, _: x * x,
    "signed square": lambda x, _: x * np.abs(x),
    "cube": lambda x, _: x**3,
    "off": lambda x, centre: x - centre,
    "off square": lambda x, centre: (x - centre) ** 2,
    "fading": lambda x, seconds: np.exp(-x / seconds),
    "sin": lambda x, period: np.sin(2.0 * np.pi * x / period),
    "cos": lambda x, period: np.cos(2.0 * np.pi * x / period),
}


def _words(factor: Factor) -> str:
    name, off = factor.variable, f"({factor.variable} {'−' if factor.number >= 0.0 else '+'} {abs(factor.number):g})"
    if factor.number == 0.0 and factor.how.startswith("off"):
        off = name if factor.how == "off" else f"({name})"
    return {
        "is": name,
        "abs": f"|{name}|",
        "square": f"({name})²",
        "signed square": f"{name}·|{name}|",
        "cube": f"({name})³",
        "off": off,
        "off square": f"{off}²",
        "fading": f"exp(−{name}/{factor.number:g} s)",
    }.get(factor.how, f"{factor.how}(2π·{name}/{factor.number:.4g})")
