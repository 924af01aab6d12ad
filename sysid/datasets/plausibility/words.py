"""Numbers in the texts of findings."""

from __future__ import annotations


def plain(number: float) -> str:
    """Three significant digits without an exponent from 1e-4 to 1e6: ``1100``, ``57.3``, ``0.0005``."""
    rounded = float(f"{number:.3g}")
    return f"{rounded:.0f}" if abs(rounded) >= 1000.0 else f"{rounded:g}"


def factor_text(factor: float) -> str:
    """``1000.0`` → "too large by a factor of 1000"; ``0.001`` → "too small by a factor of 1000"."""
    size = plain(factor if factor >= 1.0 else 1.0 / factor)
    return f"too {'large' if factor >= 1.0 else 'small'} by a factor of {size}"


def value(number: float, unit: str | None = None) -> str:
    """A value in SI, with four significant digits."""
    return f"{number:.4g} {unit}" if unit and unit != "1" else f"{number:.4g}"


def interval(low: float, high: float, unit: str | None = None) -> str:
    return f"[{low:.4g}, {high:.4g}] {unit}" if unit and unit != "1" else f"[{low:.4g}, {high:.4g}]"


def ratio_text(ratio: float) -> str:
    """``1000 times``, ``1/57.3 of``."""
    return f"{plain(ratio)} times" if ratio >= 1.0 else f"1/{plain(1.0 / ratio)} of"
