"""LeRobot datasets as version 3.0 lays them out, with the features of a leader-follower arm."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

Array = npt.NDArray[np.float64]
FPS = 30


def write_lerobot(
    folder: Path,
    episodes: Sequence[tuple[Array, Array]],
    names: Sequence[str] | dict[str, list[str]] | None,
    files: int = 1,
    version: str = "v3.0",
) -> Path:
    """A dataset of ``(action, state)``, (n, k) each, in degrees."""
    size = episodes[0][0].shape[1]
    number = {"dtype": "int64", "shape": [1], "names": None}
    motors = {"dtype": "float32", "shape": [size], "names": names}
    info = {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "total_episodes": len(episodes),
        "total_frames": sum(len(action) for action, _ in episodes),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "fps": FPS,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": {
            "action": motors,
            "observation.state": motors,
            "observation.images.front": {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), number),
        },
    }
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info), "utf-8")
    pq.write_table(pa.table({"task_index": [0], "task": ["wave"]}), folder / "meta/tasks.parquet")
    pq.write_table(pa.table({"episode_index": range(len(episodes))}), folder / "meta/episodes/chunk-000/file-000.parquet")
    (folder / "data/chunk-000").mkdir(parents=True)
    for k, part in enumerate(np.array_split(np.arange(len(episodes)), files)):
        rows = [(e, i) for e in part for i in range(len(episodes[e][0]))]
        lists = pa.list_(pa.float32(), size)
        table = {
            "action": pa.array([episodes[e][0][i].astype(np.float32) for e, i in rows], lists),
            "observation.state": pa.array([episodes[e][1][i].astype(np.float32) for e, i in rows], lists),
            "timestamp": pa.array([np.float32(i / FPS) for _, i in rows]),
            "frame_index": [i for _, i in rows],
            "episode_index": [int(e) for e, _ in rows],
            "index": range(len(rows)),
            "task_index": [0] * len(rows),
        }
        pq.write_table(pa.table(table), folder / f"data/chunk-000/file-{k:03d}.parquet", row_group_size=500)
    return folder
