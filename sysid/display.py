"""Formats SI values as text in mm, degrees and milliseconds, with significant digits; no other module converts units to show
them.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterable
from datetime import UTC, datetime

from sysid.errors import SettingsError

MINUS = "\N{MINUS SIGN}"
NARROW_SPACE = "\N{NARROW NO-BREAK SPACE}"
NOTHING = "–"

#: SI unit → factor and unit on the page.
_SHOWN = {
    "m": (1e3, "mm"),
    "rad": (180.0 / math.pi, "°"),
    "m/s": (1e3, "mm/s"),
    "rad/s": (180.0 / math.pi, "°/s"),
    "1": (1.0, ""),
}
#: Owner of a signal, or target of an effect → its word; an axis has its own name.
OWNERS = {"ee": "tip", "machine": "whole machine"}
#: Symbols that a unit may consist of, in products and quotients (``N·m·s/rad``): SI, and what clocks and logs are measured in.
_SYMBOLS = {
    *("m", "s", "kg", "A", "K", "mol", "cd", "rad", "sr", "Hz", "N", "Pa", "J", "W", "C", "V", "F", "Ω", "T", "lm", "lx"),
    *("°C", "L", "bar", "%", "ppm", "µs"),
}
_SYMBOL = re.compile(r"[^\W\d_⁰¹²³⁴⁵⁶⁷⁸⁹]+|°C|%")
_JOINTS = re.compile(r"[\s·*/()^⁻⁰¹²³⁴⁵⁶⁷⁸⁹\d.-]*")


def owner_name(target: str) -> str:
    return OWNERS.get(target, target)


def signal_name(signal: str) -> str:
    """``boom.cylinder`` → ``boom cylinder``; ``ee.x`` → ``tip x``."""
    owner, _, quantity = signal.rpartition(".")
    return f"{owner_name(owner)} {quantity}"


@functools.cache
def shown_unit(unit: str | None) -> tuple[float, str]:
    """``(factor, label)`` with ``shown = factor · value``; ``shown_unit("m") == (1000.0, "mm")``.

    Args:
        unit: SI unit; None or empty where none is stated.

    Raises:
        SettingsError: it is none.
    """
    if unit in _SHOWN or not unit:
        return _SHOWN[unit or "1"]
    if not set(_SYMBOL.findall(unit)) <= _SYMBOLS or not _JOINTS.fullmatch(_SYMBOL.sub("", unit)):
        raise SettingsError("unit of a figure", repr(unit), "an SI unit such as m, rad/s, N·m or 1")
    return 1.0, unit


def with_unit(text: str, unit: str | None) -> str:
    """The title of an axis or a curve, with the unit that its values are shown in: ``with_unit("speed", "m/s")`` is
    ``speed [mm/s]``."""
    label = shown_unit(unit)[1]
    return f"{text} [{label}]" if label else text


def number(value: float, digits: int = 3) -> str:
    """``value`` with ``digits`` significant digits, in decimal notation from 1e-5 to 1e7."""
    if not math.isfinite(value):
        return NOTHING
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if exponent < -5 or exponent > 6:
        mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
        return f"{mantissa} · 10{_superscript(int(power))}".replace("-", MINUS)
    text = f"{value:,.{max(0, digits - 1 - exponent)}f}"
    return text.replace(",", NARROW_SPACE).replace("-", MINUS)


def fixed(value: float, decimals: int) -> str:
    """``value`` with a fixed number of decimals, for columns."""
    if not math.isfinite(value):
        return NOTHING
    text = f"{value:,.{decimals}f}"
    if float(text.replace(",", "")) == 0.0:
        text = text.lstrip("-")
    return text.replace(",", NARROW_SPACE).replace("-", MINUS)


def decimals_for(values: Iterable[float], digits: int = 2) -> int:
    """Decimals at which the smallest of ``values`` still has ``digits`` significant digits (0 to 4)."""
    sizes = [abs(value) for value in values if math.isfinite(value) and value != 0.0]
    if not sizes:
        return 0
    return min(4, max(0, digits - 1 - math.floor(math.log10(min(sizes)))))


def quantity(value: float, unit: str | None, digits: int = 3) -> str:
    """``quantity(0.0034, "m") == "3.40 mm"``; seconds below one become milliseconds."""
    if unit == "s" and abs(value) < 1.0:
        return _with_unit(number(1e3 * value, digits), "ms")
    factor, label = shown_unit(unit)
    return _with_unit(number(factor * value, digits), label)


def interval(low: float, high: float, unit: str | None, digits: int = 3) -> str:
    """``interval(0.0782, 0.0836, "1") == "0.0782 to 0.0836"``, the unit once at the end."""
    factor, label = (1e3, "ms") if unit == "s" and max(abs(low), abs(high)) < 1.0 else shown_unit(unit)
    digits = max(digits, digits_for(low, high))
    return _with_unit(f"{number(factor * low, digits)} to {number(factor * high, digits)}", label)


def digits_for(low: float, high: float) -> int:
    """Significant digits at which the two ends of an interval differ clearly (3 to 7)."""
    size, width = max(abs(low), abs(high)), high - low
    if not (math.isfinite(size) and width > 0.0):
        return 3
    return min(7, max(3, math.floor(math.log10(size)) - math.floor(math.log10(width)) + 1))


def percent(share: float) -> str:
    """``percent(0.834) == "83 %"``; one decimal near 100 % and below 1 %."""
    if not math.isfinite(share):
        return NOTHING
    decimals = 1 if 0.99 < share < 0.9995 or 0.0 < abs(share) < 0.01 else 0
    return f"{100.0 * share:.{decimals}f}{NARROW_SPACE}%".replace("-", MINUS)


def ratio(value: float) -> str:
    """``ratio(33.2) == "33 ×"``, one decimal below ten."""
    if not math.isfinite(value):
        return NOTHING
    return f"{fixed(value, 1 if value < 9.95 else 0)}{NARROW_SPACE}×"


def size_text(count: float) -> str:
    """A number of bytes: ``size_text(1.5e6) == "1.5 MB"``."""
    if count < 1000.0:
        return f"{count:.0f} bytes"
    for unit in ("kB", "MB"):
        count /= 1000.0
        if count < 1000.0:
            return f"{count:.1f} {unit}"
    return f"{count / 1000.0:.1f} GB"


def minute(milliseconds: float) -> str:
    """A time since 1970 in UTC: ``2026-11-25 16:11``."""
    return f"{datetime.fromtimestamp(milliseconds / 1e3, UTC):%Y-%m-%d %H:%M}"


def _with_unit(text: str, label: str) -> str:
    if not label or text == NOTHING:
        return text
    return text + label if label.startswith("°") else f"{text}{NARROW_SPACE}{label}"


def _superscript(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
