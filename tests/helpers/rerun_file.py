"""What a Rerun recording holds over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt


def curves(path: Path) -> dict[str, tuple[npt.NDArray[np.float64], list[Any]]]:
    """Entity → times [s], and the values where they are scalars."""
    from rerun.chunk import RrdReader

    found: dict[str, tuple[list[float], list[Any]]] = {}
    for chunk in RrdReader(str(path)).stream().to_chunks():
        batch = chunk.to_record_batch()
        if "time" not in batch.schema.names:
            continue
        times, values = found.setdefault(chunk.entity_path, ([], []))
        times += list(batch.column("time").cast("int64").to_numpy() * 1e-9)
        for name in batch.schema.names:
            if name.endswith("Scalars:scalars"):
                values += [entry[0] for entry in batch.column(name).to_pylist()]
    return {entity: (np.array(times), values) for entity, (times, values) in found.items()}
