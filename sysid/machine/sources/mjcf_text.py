"""The XML of a model with its numbers in full precision.

MuJoCo writes six significant digits, which changes the torques of an arm by some 10⁻⁵ of their size. A number of a named
element is written anew from the model where both agree within that rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from sysid.machine.sources.mjcf_model import mujoco_library

Array = npt.NDArray[np.float64]
#: Largest relative difference between a number and MuJoCo's text of it.
ROUNDING = 6e-6
_BODY, _INERTIAL = ("pos", "quat"), ("pos", "quat", "mass", "diaginertia")
_JOINT = ("pos", "axis", "range", "armature", "damping", "frictionloss", "stiffness", "ref")
_ACTUATOR = ("gainprm", "biasprm", "dynprm", "gear", "ctrlrange", "delay")
_TENDON = ("range", "frictionloss", "armature", "damping")
_OPTION = ("timestep", "gravity")


def mjcf_text(spec: Any) -> str:
    """The XML of an ``MjSpec``, which is compiled first.

    Raises:
        ValueError: MuJoCo refuses the model.
    """
    from xml.etree.ElementTree import tostring

    from defusedxml.ElementTree import fromstring

    model = spec.compile()
    root: Element = fromstring(spec.to_xml())
    for option in root.findall("option"):
        _rewrite(option, _OPTION, lambda key: getattr(spec.option, key))
    for body in root.iter("body"):
        _body(model, body)
    for joint in root.iter("joint"):
        _rewrite(joint, _JOINT, _of_named(spec.joint, joint))
    for element in _children(root, "actuator"):
        _rewrite(element, _ACTUATOR, _of_named(spec.actuator, element))
    for element in _children(root, "tendon"):
        _rewrite(element, _TENDON, _of_named(spec.tendon, element))
    for site in root.iter("site"):
        _rewrite(site, _BODY, _of_named(spec.site, site))
    return tostring(root, encoding="unicode") + "\n"


def _children(root: Element, group: str) -> Iterator[Element]:
    for element in root.findall(group):
        yield from element


def _body(model: Any, body: Element) -> None:
    name = body.get("name")
    if not name:
        return
    found = int(mujoco_library().mj_name2id(model, mujoco_library().mjtObj.mjOBJ_BODY, name))
    if found < 0:
        return
    _rewrite(body, _BODY, lambda key: {"pos": model.body_pos, "quat": model.body_quat}[key][found])
    arrays = {"pos": model.body_ipos, "quat": model.body_iquat, "mass": model.body_mass, "diaginertia": model.body_inertia}
    for inertial in body.findall("inertial"):
        _rewrite(inertial, _INERTIAL, lambda key: arrays[key][found])


def _of_named(find: Callable[[str], Any], element: Element) -> Callable[[str], Any]:
    """Attributes of the element of that name in the specification; nothing where it has none."""
    name = element.get("name")
    found = find(name) if name else None
    return lambda key: getattr(found, key, None)


def _rewrite(element: Element, keys: tuple[str, ...], value: Callable[[str], Any]) -> None:
    """Write the numbers of these attributes in full where they agree with the text."""
    for key in keys:
        text = element.get(key)
        if text is None or (exact := value(key)) is None:
            continue
        try:
            written = np.array([float(part) for part in text.split()])
        except ValueError:  # a word
            continue
        numbers: Array = np.atleast_1d(np.asarray(exact, dtype=np.float64))[: len(written)]
        if len(numbers) == len(written) and (np.abs(numbers - written) <= ROUNDING * np.abs(written)).all():
            element.set(key, " ".join(_number(x) for x in numbers))


def _number(value: float) -> str:
    return repr(float(value)).removesuffix(".0")
