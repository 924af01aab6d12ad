"""Models outside of the scope: what a refusal claims of them, and whether an independent reader finds the same.

    python -m robots_corpus.outside MODEL          prints the facts of a model, in a process of its own

A model is outside where no edit of a few words makes an open chain of driven joints of it. A refusal that only says so is not
believed: without the fact the model counts as refused.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError, fromstring

Facts = Mapping[str, Any]


@dataclass(frozen=True)
class Outside:
    """``wording`` of a refusal, the ``reason`` in a few words, and what the ``facts`` of the model have to be."""

    wording: str
    reason: str
    facts: Callable[[Facts], bool]


OUTSIDE: Sequence[Outside] = (
    Outside(r"root element", "not a robot: another root element", lambda f: f["root"] not in ("robot", "mujoco")),
    Outside(r"no file|a file below", "files of the model are missing", lambda f: bool(f.get("missing"))),
    Outside(r"", "MuJoCo does not compile it", lambda f: "compiles" in f and not f["compiles"]),
    Outside(r"allocate memory", "it asks for more memory than a process has", lambda f: f.get("arena", 0) > 10**9),
    Outside(r"loop", "closed loop", lambda f: f.get("loops", 0) > 0),
    Outside(r"no driven joint|no joint|no link", "no joint to drive", lambda f: f.get("joints") == 0),
    Outside(r"no driven joint|no actuator", "no actuator", lambda f: f.get("actuators") == 0),
    Outside(r"ball joint", "ball joint", lambda f: f.get("ball", 0) > 0),
    Outside(r"muscle", "muscles", lambda f: f.get("muscles", 0) > 0),
    Outside(r"tendon", "actuators on tendons", lambda f: f.get("tendons", 0) > 0),
    Outside(r"site", "actuators on sites", lambda f: f.get("sites", 0) > 0),
    Outside(r"actuator|activation", "actuators of another law", lambda f: f.get("other_laws", 0) > 0),
    Outside(r"free joint|free base|floating", "floating base without a limb", lambda f: f.get("joints") == 0),
)


def outside(message: str, facts: Facts) -> str | None:
    """Why a model with this refusal and these facts is outside of the scope; None where it is not."""
    return next((one.reason for one in OUTSIDE if re.search(one.wording, message) and one.facts(facts)), None)


def facts_of(path: Path) -> dict[str, Any]:
    """Counts of what decides whether a model is an open chain of driven joints."""
    match = re.search(r"<([A-Za-z][\w:.-]*)", re.sub(r"<!--.*?-->", "", path.read_text("utf-8", "replace"), flags=re.DOTALL))
    root = match[1] if match else ""
    if root == "mujoco":
        return {"root": root} | _mjcf(path)
    return {"root": root} | (_urdf(path) if root == "robot" else {})


def _urdf(path: Path) -> dict[str, Any]:
    try:
        root = fromstring(path.read_text("utf-8"))
    except ParseError as error:
        return {"parses": str(error)}
    return {"joints": sum(joint.get("type") not in ("fixed", "floating") for joint in root.findall("joint"))}


def _mjcf(path: Path) -> dict[str, Any]:
    import mujoco

    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        text = " ".join(str(error).split())
        return {"compiles": False, "missing": "opening file" in text, "error": text[:300]}
    joints, on = [int(kind) for kind in model.jnt_type], [int(kind) for kind in model.actuator_trntype]
    kinds, trn, eq, dyn = mujoco.mjtJoint, mujoco.mjtTrn, mujoco.mjtEq, mujoco.mjtDyn
    laws = (dyn.mjDYN_NONE, dyn.mjDYN_INTEGRATOR, dyn.mjDYN_FILTER, dyn.mjDYN_FILTEREXACT, dyn.mjDYN_MUSCLE)
    return {
        "compiles": True,
        "arena": int(model.narena),
        "joints": sum(kind in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE) for kind in joints),
        "ball": joints.count(kinds.mjJNT_BALL),
        "free": joints.count(kinds.mjJNT_FREE),
        "actuators": len(on),
        "tendons": on.count(trn.mjTRN_TENDON),
        "sites": on.count(trn.mjTRN_SITE) + on.count(trn.mjTRN_BODY),
        "loops": sum(int(kind) in (eq.mjEQ_CONNECT, eq.mjEQ_WELD) for kind in model.eq_type),
        "muscles": sum(int(kind) == dyn.mjDYN_MUSCLE for kind in model.actuator_dyntype),
        "other_laws": sum(int(kind) not in laws for kind in model.actuator_dyntype),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    print(json.dumps(facts_of(parser.parse_args().model)))
