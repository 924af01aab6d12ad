"""What `make bench` reads is read alike by everyone; the hour it ingests comes out as it was made."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_ros2.decoder import DecoderFactory

PIPELINES = str(Path(__file__).parents[2] / "pipelines")


@pytest.fixture(scope="module")
def benchmarks() -> Iterator[dict[str, ModuleType]]:
    import importlib

    sys.path.insert(0, PIPELINES)
    try:
        yield {name: importlib.import_module(f"benchmarks.{name}") for name in ("bags", "readers", "hour", "logs")}
    finally:
        sys.path.remove(PIPELINES)


def test_all_readers_give_the_same_tables(benchmarks: dict[str, ModuleType], tmp_path: Path) -> None:
    bags, readers = benchmarks["bags"], benchmarks["readers"]
    path = bags.write_bag(tmp_path / "log.mcap", bags.Bag(300, 200))
    tables = {name: read(path) for name, read in readers.TABLES.items()}
    assert set(tables) == {"ours", "rerun", "mcap_ros2", "mcap_ros2_file_order", "rosbags"}
    for topic, rows in (("/joint_states", 300), ("/pose", 200)):
        ours = tables["ours"][topic]
        assert len(ours) == rows
        assert len(ours.columns) == {"/joint_states": 17, "/pose": 9}[topic]
        for found in tables.values():
            pd.testing.assert_frame_equal(found[topic].astype(float), ours.astype(float), check_exact=True)
    assert readers.rows_of("everything", path) == readers.rows_of("inspect", path) == 500
    assert readers.rows_of("mapped", path) == 300


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4])
def test_bags_with_images_are_bags(benchmarks: dict[str, ModuleType], tmp_path: Path, compression: CompressionType) -> None:
    bags = benchmarks["bags"]
    bag = bags.Bag(40, 30, 4, 5000, compression)
    path = bags.write_bag(tmp_path / "log.mcap", bag)
    with path.open("rb") as file:
        messages = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    assert len(messages) == bag.messages == 74
    images = [value for _, channel, _, value in messages if channel.topic == "/camera"]
    assert [(image.encoding, image.step, len(image.data)) for image in images] == [("mono8", 1024, 5000)] * 4
    stamps = [image.header.stamp.sec * 10**9 + image.header.stamp.nanosec for image in images]
    np.testing.assert_array_equal(np.diff(stamps), 100_000_000)


def test_the_hour_is_ingested_and_aligned(benchmarks: dict[str, ModuleType], tmp_path: Path) -> None:
    hour = benchmarks["hour"]
    dataset, stages = hour.ingested(hour.write_hour(tmp_path, 40.0), tmp_path / "workspace")
    assert set(stages) == {"read", "align", "resample", "check", "store"}
    (record,) = dataset.clocks
    assert record.applied
    assert abs(record.offset_s) < 2e-3
    table = pd.concat([recording.table for recording in dataset.recordings])
    assert 3700 < len(table) <= 4000  # a second on either side of a split belongs to neither part
    assert {"boom.cylinder", "boom.joint", "slew.joint", "telescope.joint", "stick.command"} <= set(table.columns)
    assert table["boom.joint"].notna().mean() > 0.99


def test_a_reader_that_fails_is_told(benchmarks: dict[str, ModuleType], tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(b"nothing")
    with pytest.raises(SystemExit, match=r"readers\.py ours failed(.|\n)*log\.mcap.*magic bytes of an MCAP file"):
        benchmarks["logs"].measured("ours", tmp_path / "log.mcap", tmp_path / "log.mcap")


def test_the_page_shows_the_committed_result_and_parts_are_named(pipeline: Callable[[str], ModuleType]) -> None:
    bench = pipeline("bench")
    rows = json.loads(bench.RESULT.read_text("utf-8"))["rows"]
    assert {row["part"] for row in rows} == set(bench.PARTS)
    assert bench.tables(rows) in bench.PAGE.read_text("utf-8")
    with pytest.raises(
        SystemExit, match="no part reader; expected some of: readers, memory, ingest, long_log, cli, registry, plant"
    ):
        bench.main(["reader", "cli"])


@pytest.mark.slow
@pytest.mark.parametrize("read", ["mapped", "inspect", "everything"])
def test_memory_does_not_grow_with_what_no_column_holds(benchmarks: dict[str, ModuleType], tmp_path: Path, read: str) -> None:
    """300 MB of images between joint states; then joint states alone, where the table itself is what grows."""
    bags, measured = benchmarks["bags"], benchmarks["logs"].measured
    warm_up = bags.write_bag(tmp_path / "warm.mcap", bags.Bag(200, 200))
    camera = bags.write_bag(tmp_path / "camera.mcap", bags.Bag(9000, 0, 300, 2**20, CompressionType.NONE))
    assert camera.stat().st_size > 300e6
    found = measured(read, camera, warm_up)
    assert found["rows"] == {"mapped": 9000}.get(read, 9300)
    assert found["peak"] - found["before"] < 60 * 2**20
    bag = bags.Bag(900_000, compression=CompressionType.NONE)
    found = measured(read, bags.write_bag(tmp_path / "states.mcap", bag), warm_up)
    assert found["rows"] == bag.messages
    # Columns and three clocks of eight bytes each, and the stamp's two words until the header's clock has been made of them.
    columns = {"mapped": 4, "inspect": 0, "everything": 2 + 15}[read]
    assert found["peak"] - found["before"] < 60 * 2**20 + bag.messages * 8 * (columns + 3 + 1)
