"""Conversion to SI on input; inside the toolkit every number is in m, rad, s, N, N·m or kg."""

from __future__ import annotations

import functools
import re
from typing import Any

from sysid.errors import InputError

#: Spellings seen in log headers that the unit library does not know. ``1/min`` and ``Hz`` are frequencies, not rates of
#: rotation: they do not say what is counted.
_SPELLINGS = {
    "": "dimensionless",
    "1": "dimensionless",
    "%": "percent",
    "°": "degree",
    "N·m": "N*m",
    "Nm": "N*m",
    "°/s": "degree/s",
    "deg/sec": "degree/s",
    "dps": "degree/s",
    "rad/sec": "rad/s",
    "m/sec": "m/s",
    "mm/sec": "mm/s",
    "rev/min": "rpm",
    "r/min": "rpm",
    "U/min": "rpm",
    "rev/s": "turn/s",
    "turns/s": "turn/s",
}


@functools.cache
def _registry() -> Any:
    import pint  # takes half a second to import

    registry: Any = pint.UnitRegistry()
    registry.define("percent = 0.01 = %")
    return registry


@functools.cache
def si_factor(unit: str, where: object = "unit") -> tuple[float, str]:
    """``(factor, si_unit)`` with ``value_si = factor * value``; ``si_factor("mm") == (0.001, "m")``.

    Raises:
        InputError: the unit is not known.
    """
    registry = _registry()
    try:
        quantity = registry.Quantity(1.0, registry.parse_units(_SPELLINGS.get(unit.strip(), unit.strip())))
        base = quantity.to_base_units()
    except Exception as error:  # the unit library raises many unrelated types for a malformed unit
        raise InputError(where, f"unknown unit {unit!r} ({type(error).__name__})", "a unit such as mm, deg, N or 1") from None
    name = _si_name(registry, quantity, base)
    return float(base.magnitude), name


def is_unit(text: str) -> bool:
    """Whether ``text`` is a unit that :func:`si_factor` knows."""
    try:
        si_factor(text)
    except InputError:
        return False
    return True


def _si_name(registry: Any, quantity: Any, base: Any) -> str:
    if base.check("[length]"):
        return "m"
    if base.check("[time]"):
        return "s"
    if base.check("[mass]"):
        return "kg"
    if base.check("[force]"):
        return "N"
    if base.check("[force] * [length]"):
        return "N·m"
    if base.check("[length] / [time]"):
        return "m/s"
    if base.check("1 / [time]") and "radian" in str(base.units):  # a rate of rotation; a frequency stays 1/s
        return "rad/s"
    if base.dimensionless:
        return "rad" if quantity.units in (registry.degree, registry.radian, registry.milliradian, registry.turn) else "1"
    return f"{base.units:~}"


_HEADER = re.compile(r"^\s*(?P<name>[^\[\]]+?(?:(?<=\S)\[\d+\])?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*$")


def split_header(header: str) -> tuple[str, str | None]:
    """``"boom.cylinder [mm]"`` → ``("boom.cylinder", "mm")``; the unit is None if none is given.

    A number directly after the name is an index, not a unit: ``"q[2] [deg]"`` → ``("q[2]", "deg")``.
    """
    match = _HEADER.match(header)
    return (header.strip(), None) if match is None else (match["name"], match["unit"])
