"""C3D and CAN: what is written is what happened, read back by the formats' own libraries and by the toolkit's ingest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import can
import cantools
import ezc3d
import numpy as np
import pytest

from simulated_bench import AXES, BenchRecipe, RecordingSettings, Run, simulate, write, write_all
from simulated_bench.can_log import MESSAGES
from simulated_bench.recipe import WIRED
from simulated_bench.recipe_file import check_recipe
from simulated_bench.site_files import pivot_in_set, write_site_files
from sysid.datasets import Store, ingest
from sysid.errors import SettingsError


@pytest.fixture(scope="module")
def other_formats(short: BenchRecipe) -> BenchRecipe:
    """Two short recordings as CAN logs and C3D trials."""
    controller = replace(short.controller, log=("blf", "asc"))
    return replace(short, controller=controller, capture=replace(short.capture, export=("c3d",)))


@pytest.fixture(scope="module")
def written(other_formats: BenchRecipe, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Run, list[Path]]:
    out = tmp_path_factory.mktemp("logs")
    files = write_all(other_formats, out)
    return out, simulate(other_formats, "drive"), files


def test_the_files_a_recipe_chooses(written: tuple[Path, Run, list[Path]]) -> None:
    out, _, files = written
    names = ["machine.blf", "machine.asc", "mocap.c3d"]
    expected = [f"{recording}/{name}" for recording in ("drive", "poses") for name in names] + ["autolog.dbc", "truth.json"]
    assert [str(path.relative_to(out)) for path in files] == expected
    assert {path for path in out.rglob("*") if path.is_file()} == set(files)


@pytest.mark.parametrize("change", [{"log": ()}, {"log": ("mcap", "mcap")}])
def test_a_choice_of_nothing_or_twice_the_same_is_refused(short: BenchRecipe, change: dict[str, tuple[str, ...]]) -> None:
    controller = replace(short.controller, **change)  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match=r"controller\.log: .*; expected at least one format, each once"):
        check_recipe(replace(short, controller=controller), "bench.toml")


@pytest.mark.parametrize("suffix", ["blf", "asc"])
def test_frames_decode_to_what_the_machine_logged(suffix: str, written: tuple[Path, Run, list[Path]]) -> None:
    out, run, _ = written
    database = cantools.database.load_file(out / "autolog.dbc")
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in MESSAGES}
    stamps: dict[str, list[float]] = {name: [] for name in MESSAGES}
    before = 0.0
    with can.LogReader(out / "drive" / f"machine.{suffix}") as reader:
        for frame in reader:
            described = database.get_message_by_frame_id(frame.arbitration_id)  # type: ignore[union-attr]
            assert described.is_extended_frame == frame.is_extended_id
            rows[described.name].append(described.decode(frame.data))  # type: ignore[arg-type]
            stamps[described.name].append(frame.timestamp)
            assert frame.timestamp >= before
            before = frame.timestamp
    log = run.log
    for column, (name, signals, values, step) in enumerate(
        [
            ("VALVE_COMMAND", AXES, log.command, 1e-4),
            ("DRAW_WIRES", WIRED, log.wires, 1e-5),
            ("SLEW_SENSOR", ("slew",), log.slew[:, None], 1e-6),
        ]
    ):
        found = np.array([[row[signal] for signal in signals] for row in rows[name]])
        assert np.abs(found - values).max() <= 0.5001 * step
        start = 0 if suffix == "blf" else int(log.published.min())
        np.testing.assert_allclose(np.array(stamps[name]), (log.published[:, column] - start) * 1e-9, rtol=0.0, atol=1.1e-6)
    assert [row["counter"] for row in rows["SLEW_SENSOR"]][250:260] == [250, 251, 252, 253, 254, 255, 0, 1, 2, 3]


def test_a_trial_holds_the_markers_that_were_seen(written: tuple[Path, Run, list[Path]]) -> None:
    out, run, _ = written
    trial = ezc3d.c3d(str(out / "drive" / "mocap.c3d"))
    parameters = trial["parameters"]["POINT"]
    assert (parameters["UNITS"]["value"], parameters["RATE"]["value"][0]) == (["mm"], run.capture.rate)
    assert parameters["LABELS"]["value"][:5] == [*(f"column_body:Marker{i}" for i in range(1, 5)), "boom_body:Marker1"]
    seen = np.concatenate([body.markers for body in run.capture.bodies], axis=1)
    points = trial["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(points, 1e3 * seen, atol=2e-4)  # floats of single precision, in millimetres
    gone = np.isnan(seen).any(axis=2)
    assert gone.any(), "the recipe has dropouts"
    np.testing.assert_array_equal(trial["data"]["meta_points"]["residuals"][0].T, np.where(gone, -1.0, 0.0))


def test_frames_between_poses_are_there_without_markers(
    written: tuple[Path, Run, list[Path]], other_formats: BenchRecipe
) -> None:
    out, _, _ = written
    take = simulate(other_formats, "poses").capture
    points = ezc3d.c3d(str(out / "poses" / "mocap.c3d"))["data"]["points"][:3]
    assert points.shape[2] == take.frames[-1] + 1
    shown = ~np.isnan(points).all(axis=(0, 1))
    assert set(np.flatnonzero(shown)) <= set(take.frames.tolist())
    assert shown.sum() > 0.9 * len(take.frames)


def test_the_same_run_gives_the_same_bytes(other_formats: BenchRecipe, tmp_path: Path) -> None:
    recording = RecordingSettings("brief", seed=3, seconds=4.0)
    for folder in ("a", "b"):
        write(simulate(other_formats, recording), tmp_path / folder)
    for name in ("machine.blf", "machine.asc", "mocap.c3d"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_the_text_log_is_dated_by_the_machine(written: tuple[Path, Run, list[Path]]) -> None:
    out, _, _ = written
    lines = (out / "drive" / "machine.asc").read_text().splitlines()
    assert lines[0] == "date Mon May 27 09:30:12.340 2024"
    assert lines[3] == "Begin Triggerblock Mon May 27 09:30:12.340 2024"


def test_where_the_origin_of_a_body_lies_among_its_markers(other_formats: BenchRecipe) -> None:
    body = next(body for body in other_formats.capture.bodies if body.name == "tip_body")
    at = pivot_in_set(body)
    markers = np.array(body.markers)
    assert body.pivot is not None
    offsets = markers.mean(axis=0) - np.array(body.pivot)
    assert np.linalg.norm(at) == pytest.approx(np.linalg.norm(offsets))
    along = markers[1] - markers[0]
    assert at[0] == pytest.approx(-offsets @ along / np.linalg.norm(along))


@pytest.fixture(scope="module")
def ingested(recipe: BenchRecipe, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """A site with these formats, ingested by the recipe that comes with it into its own workspace."""

    def build(log: str, export: str) -> Path:
        site = tmp_path_factory.mktemp("site")
        recordings = tuple(RecordingSettings(name, seed, seconds=12.0) for name, seed in (("one", 1), ("two", 2), ("three", 3)))
        capture = replace(recipe.capture, export=(export,), swaps=(), exported_markers=())  # type: ignore[arg-type]
        controller = replace(recipe.controller, log=(log,))  # type: ignore[arg-type]
        chosen = replace(recipe, recordings=recordings, capture=capture, controller=controller)
        runs = [simulate(chosen, each) for each in recordings]
        for run in runs:
            write(run, site / "logs" / run.recording.name)
        write_site_files(site, chosen, dict.fromkeys(AXES, 0.03), [], runs[0].truth.joint[0])
        assert ingest(site, site / "workspace").version == 1
        return site

    return build


def test_ingest_gives_the_same_whatever_the_format(ingested: Callable[[str, str], Path]) -> None:
    usual = Store(ingested("mcap", "motive") / "workspace").load("autolog")
    site = ingested("blf", "c3d")
    other = Store(site / "workspace").load("autolog")
    assert {record.applied for record in other.clocks} == {True}
    limits = {".command": 1e-9, ".cylinder": 1e-5, "telescope.joint": 1e-5, ".joint": 1e-4, "ee.": 1e-4, "tool.": 1e-4}
    for before, after in zip(usual.recordings, other.recordings, strict=True):
        assert list(before.table.columns) == list(after.table.columns)
        rows = min(len(before.table), len(after.table))
        for signal in before.signals:
            limit = next(value for key, value in limits.items() if key in signal)
            difference = (before.table[signal][:rows] - after.table[signal][:rows]).abs()
            assert difference.notna().mean() > 0.5, signal
            assert difference.median() < limit, signal
    assert ingest(site, site / "workspace").version == 1
    database = site / "autolog.dbc"
    database.write_bytes(database.read_bytes().replace(b"1e-05", b"1.01e-05"))
    assert ingest(site, site / "workspace").version == 2, "another database is another dataset"
