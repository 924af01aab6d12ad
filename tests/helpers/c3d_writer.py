"""C3D files put together by hand, in every byte order and storage that computers wrote."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
PROCESSORS = {"intel": (84, "<"), "dec": (85, "<"), "mips": (86, ">")}


class Writer:
    """A C3D file put together by hand, in any byte order and storage."""

    def __init__(self, processor: str = "intel", integers: bool = False) -> None:
        self.number, self.order = PROCESSORS[processor]
        self.dec, self.integers = processor == "dec", integers

    def floats(self, values: Any) -> bytes:
        data = np.asarray(values, np.float32)
        if not self.dec:
            return data.astype(f"{self.order}f4").tobytes()
        return np.ascontiguousarray((data * 4.0).astype("<f4").view("<u2").reshape(-1, 2)[:, ::-1]).tobytes()

    def words(self, *values: int) -> bytes:
        return np.array(values).astype(f"{self.order}i2").tobytes()

    def parameter(self, group: int, name: str, value: Any) -> bytes:
        if isinstance(value, list):
            width = max(map(len, value))
            body = struct.pack("bBBB", -1, 2, width, len(value)) + "".join(text.ljust(width) for text in value).encode()
        elif isinstance(value, float):
            body = struct.pack("bB", 4, 0) + self.floats([value])
        elif isinstance(value, tuple):
            body = struct.pack("bBB", 2, 1, len(value)) + self.words(*value)
        else:
            body = struct.pack("bB", 2, 0) + self.words(value)
        return struct.pack("bb", len(name), group) + name.encode() + self.words(len(body) + 3) + body + b"\0"

    def file(
        self,
        points: Array,
        analog: Array,
        parameters: dict[str, Any] | None = None,
        first: int = 1,
        residuals: Array | None = None,
    ) -> bytes:
        """``points`` (n, p, 3) in units of 0.5 mm where stored as integers; ``analog`` (n, k, c) raw values."""
        count, markers, _ = points.shape
        samples, channels = analog.shape[1:]
        scale = 0.5 if self.integers else -0.5
        named: dict[str, Any] = {
            "POINT:USED": markers, "POINT:SCALE": scale, "POINT:RATE": 50.0, "POINT:UNITS": ["mm"],
            "POINT:LABELS": [f"body:Marker{i + 1}" for i in range(markers)], "ANALOG:USED": channels,
        }  # fmt: skip
        if channels:
            named["ANALOG:LABELS"] = [f"V{i + 1}" for i in range(channels)]
        named |= parameters or {}
        groups = {group: i + 1 for i, group in enumerate(dict.fromkeys(name.split(":")[0] for name in named))}
        section = b""
        for group, number in groups.items():
            section += struct.pack("bb", len(group), -number) + group.encode() + self.words(3) + b"\0"
        for name, value in named.items():
            if value is not None:
                section += self.parameter(groups[name.split(":")[0]], name.split(":")[1], value)
        blocks = -(-(len(section) + 6) // 512)
        section = (bytes([1, 0x50, blocks, self.number]) + section).ljust(512 * blocks, b"\0")
        header = bytes([2, 0x50]) + self.words(markers, channels * samples, first, first + count - 1, 0)
        header += self.floats([scale]) + self.words(2 + blocks, samples) + self.floats([50.0])
        fourth = np.zeros((count, markers)) if residuals is None else residuals
        table = np.concatenate([points, fourth[:, :, None]], axis=2).reshape(count, -1)
        table = np.concatenate([table, analog.reshape(count, -1)], axis=1)
        body = b"".join(self.words(*map(int, row)) for row in table) if self.integers else self.floats(table.ravel())
        return header.ljust(512, b"\0") + section + body


def trial(count: int = 12, markers: int = 3, channels: int = 2, samples: int = 4) -> tuple[Array, Array]:
    rng = np.random.default_rng(5)
    points = rng.integers(1, 2000, (count, markers, 3)).astype(np.float64)
    return points, rng.integers(-2000, 2000, (count, samples, channels)).astype(np.float64)
