"""Offset and skew of a second device's clock, recovered from simulated recordings whose truth is known.

    .venv/bin/python pipelines/clock_study.py [--full] [--only gaps] [--workers 1]

A grid of durations, motions and faults, repeated with other noise: errors at mid-log and at its end, coverage of the 95 %
intervals, recordings that are refused without need, and those that are not refused although they must be. The usual methods
for an offset are compared on recordings of 300 s at 1 Hz. Writes ``reports/clock_study/result.json``, the tables of
``reports/clock_study/README.md`` and its picture.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clock_peers import PEERS, peer_rows
from clock_simulation import EPOCH, KINDS, MACHINE_HZ, NOISE, OTHER_HZ, SimulatedRecording, motion, simulated
from committed import markdown, provenance, write_result, write_tables
from log_picture import COLOURS, Curve, Panel, picture
from sysid.datasets.channel import Channel
from sysid.datasets.clocks.records import RecordingClocks, align, machine_times
from sysid.errors import AlignmentError

Array = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
REPORT = ROOT / "reports" / "clock_study"
PAGE, RESULT = REPORT / "README.md", REPORT / "result.json"
PICTURE = ROOT / "docs" / "images" / "clocks.svg"
SEED = 20251121
DURATIONS, MOTIONS = (30.0, 120.0, 300.0, 3600.0), (0.2, 0.5, 1.0, 2.0)
#: Recordings of each cell of the grid, and those of a shorter run.
SEEDS = 20
FEWER = {30.0: 20, 120.0: 20, 300.0: 20, 3600.0: 4}
NAMES = {30.0: "30 s", 120.0: "2 min", 300.0: "5 min", 3600.0: "1 h"}


@dataclass(frozen=True)
class Outcome:
    """One recording. Errors [ms, ppm] are NaN where nothing was applied.

    Args:
        holds: whether the offset's interval at the first stamp, and that of the skew, hold the truth.
        misplaced: samples between the true and the found step of a clock that was set.
    """

    seconds: float
    hertz: float
    kind: str
    refused: str
    mid_ms: float = float("nan")
    end_ms: float = float("nan")
    skew_ppm: float = float("nan")
    skew_applied: bool = False
    offset_holds: bool = False
    skew_holds: bool = False
    parted_rightly: bool = True
    misplaced: int = 0
    taken_s: float = 0.0


def recovered(seconds: float, hertz: float, kind: str, seed: int) -> Outcome:
    """Simulate one recording, align it, and compare with the truth."""
    recording = simulated(seconds, hertz, kind, SEED + seed)
    begin = time.process_time()
    try:
        records = align([recording.clocks])
    except AlignmentError as error:
        return Outcome(seconds, hertz, kind, error.found)
    taken = time.process_time() - begin
    if not records[0].applied:
        return Outcome(seconds, hertz, kind, records[0].reason)
    channel = next(c for c in recording.clocks.channels if c.domain != "machine")
    zero = (recording.clocks.start_ns - EPOCH) * 1e-9  # the recording counts from the machine's first stamp, jitter and all
    errors = machine_times(channel, recording.clocks.start_ns, records) + zero - recording.machine_s
    first, misplaced = records[0], 0
    stamps = channel.stamps
    if kind == "reset":
        true = int(np.searchsorted(recording.machine_s, recording.reset_s - 1e-9))
        found = int(np.searchsorted(stamps, records[1].stream_start_ns)) if recording.pieces == len(records) == 2 else true
        misplaced = abs(found - true)
        errors[min(true, found) : max(true, found)] = np.nan
    inside = errors[np.isfinite(errors)]
    offset = recording.machine_s[0] - zero  # of the first stamp
    return Outcome(
        seconds,
        hertz,
        kind,
        "",
        mid_ms=1e3 * float(inside[len(inside) // 2]),
        end_ms=1e3 * float(inside[-1]),
        skew_ppm=float(np.mean(first.skew_interval95)) - recording.skew_ppm,
        skew_applied=first.skew_ppm != 0.0,
        offset_holds=bool(first.offset_interval95[0] <= offset <= first.offset_interval95[1]),
        skew_holds=bool(first.skew_interval95[0] <= recording.skew_ppm <= first.skew_interval95[1]),
        parted_rightly=len(records) == recording.pieces,
        misplaced=misplaced,
        taken_s=taken,
    )


def rms(values: Sequence[float]) -> float | None:
    known = np.array([v for v in values if np.isfinite(v)])
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def cell(found: Sequence[Outcome]) -> dict[str, Any]:
    """One row of the grid."""
    done = [o for o in found if not o.refused]
    right = [o for o in done if o.parted_rightly]
    return {
        "seconds": found[0].seconds,
        "hertz": found[0].hertz,
        "kind": found[0].kind,
        "recordings": len(found),
        "refused": len(found) - len(done),
        "parted_wrongly": len(done) - len(right),
        "misplaced": max((o.misplaced for o in right), default=0),
        "mid_ms": rms([o.mid_ms for o in right]),
        "end_ms": rms([o.end_ms for o in right]),
        "skew_ppm": rms([o.skew_ppm for o in right]),
        "skew_applied": sum(o.skew_applied for o in right),
        "offset_holds": sum(o.offset_holds for o in right),
        "skew_holds": sum(o.skew_holds for o in right),
        "seconds_taken": float(np.median([o.taken_s for o in done])) if done else None,
        "reasons": sorted({o.refused.partition("(")[0].strip() for o in found if o.refused}),
    }


# ---- What has to be refused ----------------------------------------------------------------------------------------------


def _still(recording: SimulatedRecording, rng: np.random.Generator) -> RecordingClocks:
    """Both devices see a machine that stands still."""
    return _with(recording.clocks, lambda c: NOISE * rng.normal(size=len(c.values)))


def _repeating(recording: SimulatedRecording, rng: np.random.Generator) -> RecordingClocks:
    """The machine repeats one motion of 6 s over and over."""
    curve = motion(12.0, 1.0, rng)
    start = {c.domain: int(c.stamps[0]) for c in recording.clocks.channels}
    blend = lambda t: 0.5 - 0.5 * np.cos(np.clip(t % 6.0, 0.0, 6.0) / 6.0 * 2.0 * np.pi)  # noqa: E731

    def repeated(channel: Channel) -> Array:
        t = (channel.stamps - start[channel.domain]) * 1e-9
        return np.asarray(curve(t % 6.0) * blend(t) + NOISE * rng.normal(size=len(t)))

    return _with(recording.clocks, repeated)


def _unrelated(recording: SimulatedRecording, rng: np.random.Generator) -> RecordingClocks:
    """The other device looked at another machine."""
    other = simulated(120.0, 1.0, "plain", int(rng.integers(1 << 30))).clocks
    return replace(
        recording.clocks, channels=(*recording.clocks.machine, *(c for c in other.channels if c.domain != "machine"))
    )


def _nothing_shared(recording: SimulatedRecording, rng: np.random.Generator) -> RecordingClocks:
    """No joint is measured on both clocks."""
    names = {"boom.cylinder": "stick.cylinder", "slew.joint": "telescope.joint"}
    return replace(
        recording.clocks,
        channels=tuple(replace(c, signal=names[c.signal]) if c.domain == "machine" else c for c in recording.clocks.channels),
    )


def _short(recording: SimulatedRecording, rng: np.random.Generator) -> RecordingClocks:
    """The other device recorded for 5 s."""
    return replace(
        recording.clocks,
        channels=tuple(
            c if c.domain == "machine" else replace(c, stamps=c.stamps[6000:6600], values=c.values[6000:6600])
            for c in recording.clocks.channels
        ),
    )


def _with(clocks: RecordingClocks, values: Callable[[Channel], Array]) -> RecordingClocks:
    return replace(clocks, channels=tuple(replace(c, values=values(c)) for c in clocks.channels))


MUST_REFUSE: dict[str, Callable[[SimulatedRecording, np.random.Generator], RecordingClocks]] = {
    "nothing moves": _still,
    "the motion repeats": _repeating,
    "another machine was seen": _unrelated,
    "nothing is shared": _nothing_shared,
    "5 s only": _short,
}


def refusals(case: str, seeds: int) -> dict[str, Any]:
    """How often a recording that cannot be aligned is refused."""
    said: dict[str, int] = {}
    for seed in range(seeds):
        recording = simulated(120.0, 1.0, "plain", SEED + seed)
        try:
            record = align([MUST_REFUSE[case](recording, np.random.default_rng([SEED, seed]))])[0]
            text = "" if record.applied else record.reason
        except AlignmentError as error:
            text = error.found
        said[text.partition(": ")[2].partition("(")[0].strip()] = (
            said.get(text.partition(": ")[2].partition("(")[0].strip(), 0) + 1
        )
    return {"case": case, "recordings": seeds, "missed": said.get("", 0), "reasons": [key for key in said if key]}


# ---- The page ------------------------------------------------------------------------------------------------------------


def tables(rows: Sequence[dict[str, Any]], refused: Sequence[dict[str, Any]], peers: Sequence[dict[str, Any]]) -> str:
    of_peers = [
        (row["way"], *(f"{row[key]:.3f}" for key in ("mid_ms", "end_ms", "gaps_mid_ms", "gaps_end_ms"))) for row in peers
    ]
    grid = []
    for r in rows:
        right = r["recordings"] - r["refused"] - r["parted_wrongly"]
        figures = (_number(r[key]) for key in ("mid_ms", "end_ms", "skew_ppm"))
        counts = (f"{r[key]}/{right}" for key in ("skew_applied", "offset_holds", "skew_holds"))
        where = (NAMES[r["seconds"]], f"{r['hertz']:g} Hz", r["kind"], str(r["recordings"]), str(r["refused"]))
        grid.append((*where, *figures, *counts))
    by_length = []
    for seconds in (*DURATIONS, None):
        part = [r for r in rows if seconds in (r["seconds"], None)]
        if not part:
            continue
        total = sum(r["recordings"] for r in part)
        refusals_of, wrong = sum(r["refused"] for r in part), sum(r["parted_wrongly"] for r in part)
        right = max(total - refusals_of - wrong, 1)
        held = (f"{sum(r[key] for r in part) / right:.1%}" for key in ("offset_holds", "skew_holds"))
        name = NAMES[seconds] if seconds is not None else "all"
        by_length.append((name, *held, f"{refusals_of}/{total}", f"{wrong}/{total}"))
    must = [(r["case"], str(r["recordings"]), str(r["missed"]), "; ".join(r["reasons"])) for r in refused]
    errors, held_in = ("mid [ms]", "end [ms]"), ("offset held", "skew held")
    return "\n\n".join(
        [
            markdown(("way", *errors, "mid, with gaps [ms]", "end, with gaps [ms]"), of_peers),
            markdown(("log", "motion", "with", "n", "refused", *errors, "skew [ppm]", "skew applied", *held_in), grid, "lrl"),
            markdown(("log", *held_in, "refused", "parted wrongly"), by_length),
            markdown(("must be refused", "recordings", "missed", "reason given"), must, "lrrl"),
        ]
    )


def curves(rows: Sequence[Mapping[str, Any]]) -> str:
    """SVG: errors of time at the end of the log and of the skew, by motion; dashed for recordings with faults."""
    panels = []
    for title, key in (("error at the end of the log [ms]", "end_ms"), ("error of the skew [ppm]", "skew_ppm")):
        curves = []
        for colour, hertz in zip(COLOURS, MOTIONS, strict=False):
            for kind in dict.fromkeys(row["kind"] for row in rows):
                own = [row for row in rows if row["hertz"] == hertz and row["kind"] == kind and row[key]]
                label = f"{hertz:g} Hz" if kind == "plain" else ""
                x, y = ([row[name] for row in own] for name in ("seconds", key))
                curves.append(Curve(label, colour, x, y, dashed=kind != "plain"))
        panels.append(Panel(title, curves, {seconds: NAMES[seconds] for seconds in DURATIONS}))
    return picture(panels)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help=f"{SEEDS} recordings of every cell, an hour's as well")
    parser.add_argument("--only", default="", help="one fault; nothing is written then")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    kinds = [kind for kind in KINDS if args.only in ("", kind)]
    grid = [(t, h, k) for t in DURATIONS for h in MOTIONS for k in kinds]
    jobs = [(*where, seed) for where in grid for seed in range(SEEDS if args.full else FEWER[where[0]])]
    with ProcessPoolExecutor(args.workers) as pool:
        found = list(pool.map(recovered, *zip(*jobs, strict=True), chunksize=2))
    rows = [cell([o for o in found if (o.seconds, o.hertz, o.kind) == where]) for where in grid]
    refused = [refusals(case, SEEDS if args.full else 6) for case in MUST_REFUSE]
    peers = peer_rows(SEED, SEEDS)
    text = tables(rows, refused, peers)
    print(text)
    if args.only:
        return
    command = f"python pipelines/clock_study.py{' --full' if args.full else ''} --workers {args.workers}"
    conditions = {
        "noise": NOISE, "machine_hz": MACHINE_HZ, "other_hz": OTHER_HZ, "skew_ppm": [-100, 100], "pairs": 2,
        "peers": PEERS,
    }  # fmt: skip
    head = provenance(command, SEED)
    write_result(RESULT, {**head, "conditions": conditions, "peers": peers, "rows": rows, "must_refuse": refused})
    PICTURE.write_text(curves(rows), "utf-8")
    write_tables(PAGE, text, "pipelines/clock_study.py")


if __name__ == "__main__":
    main()
