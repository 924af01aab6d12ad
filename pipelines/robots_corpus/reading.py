"""Reads a model with ``sysid init --from``, follows the remedies of refusals, and classifies the outcome."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from robots_corpus.corpus import Robot
from robots_corpus.limited import Done, Limits, run
from robots_corpus.mirror import Mirror
from robots_corpus.outside import outside
from robots_corpus.remedy import follow
from robots_corpus.steps import CHECK, NAME, part

#: Of one run of ``sysid init``: processor time and wall time [s], memory [bytes].
LIMITS = Limits(cpu=20, wall=60.0, memory=10**9)
#: Most remedies that are followed one after another.
FOLLOWED = 3

#: Keys of the result of ``sysid init`` whose lines say what of the model the machine has not, or what it takes for it.
_NOTES = ("notes", "left_out", "assumed")


def init_command(folder: Path, path: Path, options: Sequence[str]) -> list[str]:
    command = [sys.executable, "-m", "sysid.cli", "init", str(folder / "site"), "--name", NAME, "--from", str(path)]
    return [*command, *options, "--json", str(folder / "init.json")]


def refusal(done: Done) -> str:
    """The message of a refusal, in one line."""
    return re.sub(r"^.*?\bsysid: ", "", " ".join(done.text.split()))


def internal(done: Done) -> str:
    """An error of the program that is shown as one of the file; empty where there is none."""
    match = re.search(r"cannot be read \(\w*(?:Import|Name|Attribute|Type|Key|Index|Assertion|Runtime)Error[^;]*", done.text)
    return match[0][:200] if match else ""


def notes_of(result: Path) -> list[str]:
    """Notes in the result of ``sysid init``."""
    found = json.loads(result.read_text("utf-8")) if result.is_file() else {}
    return [line for key in _NOTES for line in found.get(key, [])]


def read(robot: Robot, folder: Path) -> dict[str, Any]:
    """The outcome of one model: status, reason, steps, what the runs used.

    ``folder/site`` is the folder that ``sysid init`` makes, ``folder/model`` the mirror with edited files.
    """
    mirror = Mirror(robot.root, folder / "model")
    for old in (folder / "site", mirror.copy):
        shutil.rmtree(old, ignore_errors=True)
    (folder / "init.json").unlink(missing_ok=True)
    options, steps, runs = dict[str, str](), list[dict[str, str]](), list[Done]()
    path = robot.path
    while True:
        runs.append(done := run(init_command(folder, path, [word for pair in options.items() for word in pair]), LIMITS))
        if done.code == 0 or done.broke or len(steps) == FOLLOWED:
            return _outcome(robot, runs, steps, options, path, folder)
        message = refusal(done)
        words, edit = follow(message, robot.file, mirror)
        given = dict(zip(words[::2], words[1::2], strict=True))
        if not edit and all(options.get(key) == value for key, value in given.items()):
            return _outcome(robot, runs, steps, options, path, folder)  # no remedy, or the one that was followed already
        options |= given
        path = mirror.copy / robot.file if edit else path
        followed = "; ".join(filter(None, (edit, shlex.join(words))))
        steps.append({"message": _short(message, robot, folder), "followed": _short(followed, robot, folder)})


def _short(message: str, robot: Robot, folder: Path) -> str:
    """Without the folders of this machine."""
    for place in (folder / "model", robot.root, robot.root.resolve(), folder):
        message = message.replace(f"{place}/", "")
    return message[:600]


def _outcome(
    robot: Robot, runs: Sequence[Done], steps: Sequence[dict[str, str]], options: dict[str, str], path: Path, folder: Path
) -> dict[str, Any]:
    done, broke = runs[-1], next((found for each in runs if (found := each.broke or internal(each))), "")
    row: dict[str, Any] = {"package": robot.package, "file": robot.file, "status": "read", "reason": ""}
    if done.code != 0:
        row["reason"] = done.broke or _short(refusal(done), robot, folder)
    if done.code != 0 or steps:
        row["status"] = "refused"
    if done.code != 0 and not broke:
        row["facts"] = part("outside", [path], CHECK)
        if (reason := outside(row["reason"], row["facts"])) is not None:
            row |= {"status": "outside", "outside": reason}
    return row | {
        "read": done.code == 0,
        "broke": broke,
        "steps": list(steps),
        "options": options,
        "model": str(path.relative_to(folder)) if path != robot.path else "",
        "notes": notes_of(folder / "init.json") if done.code == 0 else [],
        "seconds": max(each.seconds for each in runs),
        "memory_mib": max(each.memory for each in runs),
    }
