"""Random LeRobot datasets, written and read by LeRobot itself, for ``reader_peers.py``: the other side of its comparison.

It runs in an environment with LeRobot and without sysid (``make reader-peers``), one line on each pipe for each set:

    in:  {"seed": [0, 17], "folder": "/tmp/…"}
    out: {"version": "v3.0"}  once, then {"rows": 42} for each set

``folder/set`` is the dataset and ``folder/loaded.npz`` what ``LeRobotDataset`` reads of it: feature → its values, (rows, …).
LeRobot 0.3.3 writes and reads the layout v2.1, 0.4.4 the layout v3.0.
"""

import json
import logging
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

#: Kinds of features, and how often each of them occurs beside the others.
KINDS = {"float32": 4, "float64": 2, "int64": 2, "int32": 1, "uint8": 1, "bool": 1, "string": 1}


def features_of(rng: np.random.Generator) -> dict[str, dict[str, Any]]:
    """Random features: numbers and lists of them with and without names, matrices, flags, texts."""
    found: dict[str, dict[str, Any]] = {}
    for name in ("action", "observation.state", "observation.effort", "next.done", "extra")[: int(rng.integers(1, 6))]:
        kind = str(rng.choice([kind for kind, share in KINDS.items() for _ in range(share)]))
        shape = (int(rng.choice([1, 1, 2, 3, 6])),) if rng.random() < 0.9 else (2, int(rng.integers(1, 4)))
        if kind in ("bool", "string"):
            shape = (1,)
        motors = [f"joint_{k}.pos" for k in range(shape[0])]
        styles: list[Any] = [None, motors, {"motors": motors}, [str(k + 1) for k in range(shape[0])]]
        found[name] = {"dtype": kind, "shape": shape, "names": styles[int(rng.integers(4))] if len(shape) == 1 else None}
    return found


def value_of(rng: np.random.Generator, kind: str, shape: tuple[int, ...]) -> Any:
    if kind == "string":
        return "x" * int(rng.integers(1, 6))
    if kind.startswith("float"):
        return rng.normal(0.0, 50.0, shape).astype(kind)
    return rng.integers(0, 2 if kind == "bool" else 200, shape).astype(kind)


def write_set(library: Any, rng: np.random.Generator, root: Path) -> None:
    """One to three short episodes; layout v3.0 in one file or several, as after pauses of the recording.

    An episode has two frames at least: LeRobot 0.4.4 cannot write the statistics of a single one.
    """
    features = features_of(rng)
    rate = int(rng.choice([10, 30, 50, 60]))
    made = library.LeRobotDataset.create("local/set", rate, features, root=root, use_videos=False)
    for _ in range(int(rng.integers(1, 4))):
        for _ in range(int(rng.integers(2, 13))):
            frame = {name: value_of(rng, about["dtype"], about["shape"]) for name, about in features.items()}
            task = str(rng.choice(["pick", "place"]))
            if library.CODEBASE_VERSION == "v2.1":
                made.add_frame(frame, task)
            else:
                made.add_frame({**frame, "task": task})
        made.save_episode()
        if library.CODEBASE_VERSION != "v2.1" and rng.random() < 0.2:  # recorded later: its episodes are in another file
            made.finalize()
            made = library.LeRobotDataset("local/set", root=root)
    if library.CODEBASE_VERSION != "v2.1":
        made.finalize()


def loaded(library: Any, root: Path) -> dict[str, Any]:
    """Feature → its values, frame after frame as the loader gives them."""
    found: dict[str, list[Any]] = {}
    data = library.LeRobotDataset("local/set", root=root)
    for row in range(len(data)):
        for name, value in data[row].items():
            if not isinstance(value, str):
                found.setdefault(name, []).append(value.numpy())
    return {name: np.array(values) for name, values in found.items()}


def main() -> None:
    torch: Any = import_module("torch")
    # Built for another torch than the one beside it, torchvision has no operators and cannot be imported; none is used here.
    operators = torch.library.Library("torchvision", "FRAGMENT")
    for name in ("nms", "qnms"):
        if not hasattr(torch.ops.torchvision, name):
            operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    answers, sys.stdout = sys.stdout, sys.stderr  # the libraries print
    logging.disable(logging.WARNING)
    library: Any = import_module("lerobot.datasets.lerobot_dataset")
    settings: Any = import_module("datasets.config")
    print(json.dumps({"version": library.CODEBASE_VERSION}), file=answers, flush=True)
    for line in sys.stdin:
        task = json.loads(line)
        folder = Path(task["folder"])
        settings.HF_DATASETS_CACHE = folder / "cache"
        write_set(library, np.random.default_rng(task["seed"]), folder / "set")
        values = loaded(library, folder / "set")
        np.savez(folder / "loaded.npz", **values)
        print(json.dumps({"rows": len(values["timestamp"])}), file=answers, flush=True)


if __name__ == "__main__":
    main()
