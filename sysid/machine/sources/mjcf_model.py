"""An MJCF compiled within limits, the names in it, and its XML with the numbers of a model in full precision.

A model can ask for any amount of memory and time (``replicate``, ``size``, height fields), so that it is compiled in a confined
process (:mod:`sysid.confined`) first, once for each state of its files.

MuJoCo writes six significant digits, which changes the torques of an arm by some 10⁻⁵ of their size. A number of a named
element is written anew from the model where both agree within that rounding.

Source: MuJoCo 4 documentation, *XML reference* and *Computation*.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from sysid.confined import Limits, confined, inside
from sysid.errors import InputError
from sysid.foreign import MAX_NAME, shown, visible
from sysid.machine.sources.draft import summarised
from sysid.machine.sources.mjcf_files import STANDIN_HEIGHTS, STANDIN_MESH, JoinedModel, MissingFile, joined_model

Array = npt.NDArray[np.float64]

T = TypeVar("T")

#: Of reading a description: the largest models of the MuJoCo Menagerie take a tenth of both.
DESCRIPTION_LIMITS = Limits(2**30, 20.0, "a robot description", "leave out of it what is not part of the robot")
#: Largest length of MuJoCo's message that is repeated.
_MESSAGE = 300

#: Widest backlash [rad or m].
WIDEST_BACKLASH = 0.1

#: Words of MuJoCo's message → what to do.
_REMEDIES = {
    "larger than mjMINVAL": 'Give the body an <inertial>, or write <compiler boundmass="1e-6" boundinertia="1e-9"/>.',
    "repeated name": "Rename one of the two elements, and what refers to it.",
    "unrecognized element": "Remove it, or write it as the XML reference of the installed version of MuJoCo has it.",
    "unrecognized attribute": "Remove it, or write it as the XML reference of the installed version of MuJoCo has it.",
    "not found": "Give this file to MuJoCo through the one that includes it, if it is a part of a model.",
}

#: File → its device, number, size [B] and time of change [ns].
FileStates = dict[str, tuple[int, ...]]
#: Path, folders and whether contacts count → files of a model that was compiled in a confined process.
_compiled: dict[tuple[str, tuple[str, ...], bool], FileStates] = {}


@dataclass(frozen=True)
class ReadModel:
    """A compiled model.

    Args:
        model: ``mujoco.MjModel``.
        left_out: files that were not opened, on which no mass depends.
    """

    model: Any
    left_out: tuple[str, ...]


def mujoco_library() -> Any:
    """The module ``mujoco`` (extra ``mujoco``); its warnings are counted in its data, and not written to a file."""
    import mujoco

    mujoco.set_mju_user_warning(_ignored)
    return mujoco


def read_mjcf(path: Path, assets: Sequence[Path] | None = ()) -> ReadModel:
    """The model of a file for its kinematics and masses: shapes without their file are left out where no mass depends on them.

    Args:
        assets: further folders below which files may be opened; None where the user has no option to name one.

    Raises:
        InputError: no such file, a file that must not be opened, a mass that depends on one, MuJoCo refuses it, or it takes
            more than :data:`DESCRIPTION_LIMITS`.
    """
    joined = _tried(path, assets, contacts=False)
    model = _compile(joined, _specification(joined, contacts=False))
    _check_inertias(model, joined)
    notes = [(f"{file.kind} without its file:", visible(file.name, MAX_NAME)) for file in joined.missing]
    return ReadModel(model, tuple(summarised(notes)))


def load_mjcf(path: Path, assets: Sequence[Path] | None = ()) -> Any:
    """The compiled ``mujoco.MjModel`` of a file for simulation: shapes that collide need their file too.

    Args, Raises: as of :func:`read_mjcf`.
    """
    joined = _tried(path, assets, contacts=True)
    return _compile(joined, _specification(joined, contacts=True))


def load_spec(path: Path, assets: Sequence[Path] | None = ()) -> Any:
    """The ``mujoco.MjSpec`` of a file, which can be changed before it is compiled; file names in it are relative to ``path``.

    Args, Raises: as of :func:`load_mjcf`.
    """
    return _specification(_tried(path, assets, contacts=True), contacts=True)


def _tried(path: Path, assets: Sequence[Path] | None, contacts: bool) -> JoinedModel:
    """The joined model, which has been compiled in a confined process."""
    key = os.path.abspath(path), tuple(map(os.path.abspath, assets or ())), contacts
    if not inside() and ((before := _compiled.get(key)) is None or before != _states(before)):
        mujoco_library()  # before the process begins, so that each has it
        _compiled[key] = confined(lambda report: _compiled_once(path, assets, contacts), path, DESCRIPTION_LIMITS, ())
    return joined_model(path, assets)


def _compiled_once(path: Path, assets: Sequence[Path] | None, contacts: bool) -> FileStates:
    joined = joined_model(path, assets)
    states = _states(joined.files)
    model = _compile(joined, _specification(joined, contacts))
    _of_mujoco(joined, lambda: mujoco_library().MjData(model))
    return states


def _states(files: Sequence[str] | FileStates) -> FileStates:
    found: FileStates = {}
    for file in files:
        try:
            status = os.stat(file)
        except OSError:
            found[file] = ()
        else:
            found[file] = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
    return found


def _specification(joined: JoinedModel, contacts: bool) -> Any:
    mujoco = mujoco_library()
    folder = mujoco.MjVfs()
    model = joined.path if joined.path.endswith(".xml") else f"{joined.path}.xml"  # by which MuJoCo chooses the format
    for place, text in joined.texts.items():
        folder[model if place == joined.path else place] = text.encode()
    spec = _of_mujoco(joined, lambda: mujoco.MjSpec.from_file(model, vfs=folder))
    if joined.missing:
        _check_stand_ins(spec, joined, contacts)
    if not contacts:  # room for constraints of a simulation, which is gigabytes in some models
        spec.memory = spec.njmax = spec.nconmax = -1
    return spec


def _compile(joined: JoinedModel, spec: Any) -> Any:
    return _of_mujoco(joined, spec.compile)


def _of_mujoco(joined: JoinedModel, work: Callable[[], T]) -> T:
    """What ``work`` returns; MuJoCo raises errors of many types, and ones of the allocator as RuntimeError or FatalError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return work()
    except MemoryError:
        raise DESCRIPTION_LIMITS.exceeded(joined.source, seconds=False) from None
    except Exception as error:
        found = visible(" ".join(_placed(joined, str(error) or type(error).__name__).split()), _MESSAGE)
        if isinstance(error, ValueError) and "allocate memory" not in found:
            remedy = next((text for words, text in _REMEDIES.items() if words in found), "")
            raise InputError(joined.source, found, "an MJCF that MuJoCo compiles", remedy) from None
        remedy = "Check the sizes and counts that it states."
        raise InputError(joined.source, f"MuJoCo fails on it ({found})", "an MJCF that MuJoCo compiles", remedy) from None


def _placed(joined: JoinedModel, message: str) -> str:
    """A message with the lines of the files in place of those of the joined text."""

    def place(match: re.Match[str]) -> str:
        number = int(match[1])
        if not 0 < number <= len(joined.lines):
            return match[0]
        file, line = joined.lines[number - 1]
        return f"line {line}" if file == joined.source else f"line {line} of {file.name}"

    return re.sub(r"\bline (\d{1,9})\b", place, message)


def _check_inertias(model: Any, joined: JoinedModel) -> None:
    """Check that the inertia of each joint at the reference pose is positive and finite, as a negative ``armature`` is not.

    Raises:
        InputError: it is not.
    """
    for joint, dof in zip(model.dof_jntid, model.dof_M0, strict=True):
        if not 0.0 < dof < math.inf:
            where = f"{joined.source}: joint {shown(joint_name(model, int(joint)))}"
            raise InputError(where, f"inertia {dof:g} at the reference pose", "a positive number", "Check masses and armature.")


def _check_stand_ins(spec: Any, joined: JoinedModel, contacts: bool) -> None:
    """Check that nothing that is read from the model depends on a shape without its file.

    Raises:
        InputError: the mass of a body does, or (with ``contacts``) a contact or a force of the fluid.
    """
    stand_ins = {("mesh", str(mesh.name)) for mesh in spec.meshes if tuple(mesh.uservert) == STANDIN_MESH}
    stand_ins |= {("hfield", str(item.name)) for item in spec.hfields if tuple(item.userdata) == STANDIN_HEIGHTS}
    missing = {(file.kind, file.name): file for file in joined.missing}
    for geom in spec.geoms:
        for key in {("mesh", str(geom.meshname)), ("hfield", str(geom.hfieldname))} & stand_ins & missing.keys():
            body = geom.parent
            if _weighs(spec, geom, body):
                why = f"the mass of body {shown(str(body.name))} comes from it"
                raise _needed(missing[key], why, ", or an <inertial> in that body")
            if contacts and _collides(spec, geom):
                raise _needed(missing[key], "a shape that collides, or on which a fluid acts, is made of it", "")


def _weighs(spec: Any, geom: Any, body: Any) -> bool:
    """Whether MuJoCo takes mass or inertia of a body from a geom."""
    kinds, rule = mujoco_library().mjtInertiaFromGeom, spec.compiler.inertiafromgeom
    if spec.worldbody == body or rule == kinds.mjINERTIAFROMGEOM_FALSE:
        return False
    if rule == kinds.mjINERTIAFROMGEOM_AUTO and body.explicitinertial:
        return False
    low, high = spec.compiler.inertiagrouprange
    return bool(low <= geom.group <= high) and geom.mass != 0.0 and not (math.isnan(geom.mass) and geom.density == 0.0)


def _collides(spec: Any, geom: Any) -> bool:
    """Whether contacts or the fluid act on a geom."""
    if geom.fluid_ellipsoid:
        return True
    if spec.option.disableflags & mujoco_library().mjtDisableBit.mjDSBL_CONTACT:
        return False
    paired = {str(name) for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    return bool(geom.contype or geom.conaffinity or str(geom.name) in paired)


def _needed(missing: MissingFile, why: str, otherwise: str) -> InputError:
    refusal = missing.refusal
    return InputError(refusal.where, f"{refusal.found}, and {why}", f"{refusal.expected}{otherwise}", refusal.remedy)


def body_name(model: Any, body: int) -> str:
    """The name of a body, or one made of its number."""
    return str(model.body(body).name) or f"body_{body}"


def joint_name(model: Any, joint: int) -> str:
    """The name of a joint, or one made of its number."""
    return str(model.joint(joint).name) or f"joint_{joint}"


def actuator_name(model: Any, actuator: int) -> str:
    """The name of an actuator, or one made of its number."""
    return str(model.actuator(actuator).name) or f"actuator_{actuator}"


def joints_of(model: Any, body: int) -> list[int]:
    """Joints of a body, in the order in which they move it, without those that are the backlash of the one before."""
    first = int(model.body_jntadr[body])
    return [j for j in range(first, first + int(model.body_jntnum[body])) if not is_backlash(model, j)]


def backlash_of(model: Any, joint: int) -> float:
    """Width of the backlash behind a joint [rad or m]; zero where there is none."""
    return float(np.ptp(model.jnt_range[joint + 1])) if joint + 1 < model.njnt and is_backlash(model, joint + 1) else 0.0


def is_backlash(model: Any, joint: int) -> bool:
    """Whether a joint is the backlash of the one before it: free between two ends, about the same axis, and not driven."""
    ahead = joint - 1
    if ahead < 0 or model.jnt_bodyid[ahead] != model.jnt_bodyid[joint] or model.jnt_type[ahead] != model.jnt_type[joint]:
        return False
    driven = joint_actuators(model)
    low, high = (float(end) for end in model.jnt_range[joint])
    coupled = model.eq_type == int(mujoco_library().mjtEq.mjEQ_JOINT)
    return bool(
        ahead in driven
        and joint not in driven
        and model.jnt_limited[joint]
        and 0.0 < high - low <= WIDEST_BACKLASH
        and abs(high + low) <= 0.01 * (high - low)
        and np.allclose(model.jnt_axis[ahead], model.jnt_axis[joint], atol=1e-6)
        and np.allclose(model.jnt_pos[ahead], model.jnt_pos[joint], atol=1e-6)
        and not model.jnt_stiffness[joint]
        and joint not in {*model.eq_obj1id[coupled], *model.eq_obj2id[coupled]}
    )


def joint_actuators(model: Any) -> dict[int, list[int]]:
    """Joint → actuators that act on it alone and are not switched off."""
    kinds = mujoco_library().mjtTrn
    found: dict[int, list[int]] = {}
    for k in range(model.nactuator):
        if is_off(model, k):
            continue
        if int(model.actuator_trntype[k]) in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
            found.setdefault(int(model.actuator_trnid[k, 0]), []).append(k)
    return found


def is_off(model: Any, actuator: int) -> bool:
    """Whether a flag or the group of an actuator switches it off."""
    flag, group = int(mujoco_library().mjtDisableBit.mjDSBL_ACTUATION), int(model.actuator_group[actuator])
    return bool(model.opt.disableflags & flag) or (0 <= group <= 30 and bool(model.opt.disableactuator >> group & 1))


def path_to(model: Any, body: int) -> list[int]:
    """Bodies from the child of the world to ``body``."""
    path = []
    while body != 0:
        path.append(body)
        body = int(model.body_parentid[body])
    return path[::-1]


def _ignored(text: str) -> None:
    """MuJoCo's warnings."""


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
