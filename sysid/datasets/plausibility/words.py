"""Numbers in the texts of findings."""

from __future__ import annotations


def factor_text(factor: float) -> str:
    """``1000.0`` → "too large by a factor of 1000"; ``0.001`` → "too small by a factor of 1000"."""
    size = factor if factor >= 1.0 else 1.0 / factor
    return (
        f"too {'large' if factor >= 1.0 else 'small'} by a factor of {size:.3g}"
        if size < 1000
        else (f"too {'large' if factor >= 1.0 else 'small'} by a factor of {size:.0f}")
    )


def value(number: float, unit: str | None = None) -> str:
    """A value in SI, with four significant digits."""
    return f"{number:.4g} {unit}" if unit and unit != "1" else f"{number:.4g}"


def interval(low: float, high: float, unit: str | None = None) -> str:
    return f"[{low:.4g}, {high:.4g}] {unit}" if unit and unit != "1" else f"[{low:.4g}, {high:.4g}]"


def ratio_text(ratio: float) -> str:
    """``1000 times``, ``1/57.3 of``."""
    return f"{ratio:.3g} times" if ratio >= 1.0 else f"1/{1.0 / ratio:.3g} of"
