"""Files that end between two records, so that nothing but their own head or their other parts says that they were longer."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_logs import MOTIVE_1_25, VICON, write_log

from sysid.logs import ReadOptions, reader_named


def losses(path: Path, reader: str, **options: str) -> set[str]:
    streams = reader_named(reader, path).read(path, ReadOptions(**options))  # type: ignore[arg-type]
    return {loss for stream in streams for loss in stream.losses}


@pytest.mark.parametrize("rows", [0, 1, 3])
def test_a_motive_export_without_its_last_frames(tmp_path: Path, rows: int) -> None:
    path = tmp_path / "take.csv"
    lines = [MOTIVE_1_25[0] + ",Total Exported Frames,12", *MOTIVE_1_25[1:]]
    path.write_text("\n".join(lines[: len(lines) - rows]) + "\n")
    expected = {f"take.csv: the file is cut off: {12 - rows} of 12 frames are there"} if rows else set()
    assert losses(path, "motive") == expected


@pytest.mark.parametrize("rows", [0, 2])
def test_a_motive_export_of_records_without_its_last_frames(tmp_path: Path, rows: int) -> None:
    path = write_log(tmp_path, "motive_1_1.csv")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[: len(lines) - rows]))
    expected = {f"motive_1_1.csv: the file is cut off: {12 - rows} of 12 frames are there"} if rows else set()
    assert losses(path, "motive", length_unit="m") == expected


@pytest.mark.parametrize("rows", [0, 2])
def test_a_vicon_export_whose_last_section_ends_early(tmp_path: Path, rows: int) -> None:
    path = tmp_path / "trial.csv"
    path.write_text("\n".join(VICON[: len(VICON) - 1 - rows]) + "\n")
    expected = {"trial.csv: the file is cut off: Devices ends at frame 10, other sections at 12"} if rows else set()
    assert losses(path, "vicon") == expected


@pytest.mark.parametrize("missing", [0, 1, 40])
def test_a_blf_file_that_is_shorter_than_its_head_says(tmp_path: Path, missing: int) -> None:
    path = write_log(tmp_path, "log.blf")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - missing])
    found = {loss for loss in losses(path, "can") if "the file is cut off" in loss}
    size = len(content)
    assert found == ({f"log.blf: the file is cut off: {size - missing} of {size} bytes are there"} if missing else set())
