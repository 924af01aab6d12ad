"""Passive joints of a URDF: ``<mimic joint="m" multiplier="r" offset="z"/>`` makes a joint follow another, ``q = r·q_m + z``.

Parallel linkages (palletisers, excavator buckets) are written so in a URDF, which only has trees. A passive joint may follow
another passive one.

Source: URDF specification (ROS wiki, ``urdf/XML/joint``, element ``mimic``).
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from sysid.errors import SettingsError, nearest
from sysid.numbers import Finite, number

#: Attributes of the element and their default values.
_NUMBERS = (("multiplier", "1"), ("offset", "0"))


@dataclass(frozen=True)
class Mimic:
    """``q = ratio·q_master + offset`` [rad or m]."""

    master: str
    ratio: float = 1.0
    offset: float = 0.0


def parse_mimic(element: Element, joint: str) -> Mimic | None:
    """The ``mimic`` of a joint element; None without one.

    Raises:
        SettingsError: no master, or a multiplier or offset that is not a finite number.
    """
    found = element.find("mimic")
    if found is None:
        return None
    where = f"urdf: joint {joint!r}: mimic"
    if not found.get("joint"):
        raise SettingsError(where, "no joint", 'joint="<the joint that it follows>"')
    ratio, offset = (number(found.get(key, default), Finite, f"{where}: {key}") for key, default in _NUMBERS)
    return Mimic(str(found.get("joint")), ratio, offset)


def resolved(joint: str, mimics: Mapping[str, Mimic | None]) -> Mimic:
    """The joint that moves by itself and that ``joint`` finally follows; itself where it is not passive.

    Args:
        mimics: of all joints of the URDF.

    Raises:
        SettingsError: an unknown master, or joints that follow each other in a cycle.
    """
    name, ratio, offset, seen = joint, 1.0, 0.0, [joint]
    while (step := mimics[name]) is not None:
        where = f"urdf: joint {name!r}: mimic"
        if step.master not in mimics:
            close = difflib.get_close_matches(step.master, mimics, n=1, cutoff=0.0)[0]
            remedy = f'Write joint="{close}", if that is the one, or remove the <mimic>.'
            raise SettingsError(where, f"unknown joint {step.master!r}", nearest(step.master, mimics), remedy)
        ratio, offset = ratio * step.ratio, ratio * step.offset + offset
        name = step.master
        if name in seen:
            raise SettingsError(where, f"a cycle: {' → '.join([*seen, name])}", "a joint that an axis moves at the end")
        seen.append(name)
    return Mimic(name, ratio, offset)


def followed(joint: str, mimics: Mapping[str, Mimic | None]) -> Mimic | None:
    """As :func:`resolved`; None where it follows a joint that does not exist, or a cycle."""
    try:
        return resolved(joint, mimics)
    except SettingsError:
        return None
