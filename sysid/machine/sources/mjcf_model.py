"""A compiled MJCF and the names in it.

Source: MuJoCo 4 documentation, *XML reference* and *Computation*.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from sysid.errors import InputError
from sysid.foreign import shown

#: Largest length of MuJoCo's message that is repeated.
_MESSAGE = 300


def mujoco_library() -> Any:
    """The module ``mujoco`` (extra ``mujoco``); its warnings are counted in its data, and not written to a file."""
    import mujoco

    mujoco.set_mju_user_warning(_ignored)
    return mujoco


def load_mjcf(path: Path) -> Any:
    """The compiled ``mujoco.MjModel`` of a file.

    Raises:
        InputError: no such file, or MuJoCo refuses it.
    """
    return _read(mujoco_library().MjModel.from_xml_path, path)


def load_spec(path: Path) -> Any:
    """The ``mujoco.MjSpec`` of a file, which can be changed before it is compiled.

    Raises:
        InputError: no such file, or MuJoCo refuses it.
    """
    return _read(mujoco_library().MjSpec.from_file, path)


def _read(reader: Callable[[str], Any], path: Path) -> Any:
    if not path.is_file():
        raise InputError(path, "no such file", "an MJCF file")
    try:
        return reader(str(path))
    except ValueError as error:
        raise InputError(path, shown(" ".join(str(error).split()))[1:-1][:_MESSAGE], "an MJCF that MuJoCo compiles") from None


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
    """Joints of a body, in the order in which they move it."""
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))


def path_to(model: Any, body: int) -> list[int]:
    """Bodies from the child of the world to ``body``."""
    path = []
    while body != 0:
        path.append(body)
        body = int(model.body_parentid[body])
    return path[::-1]


def _ignored(text: str) -> None:
    """MuJoCo's warnings."""
