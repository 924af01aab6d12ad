"""The proof in the PyBullet world: the held-out commands move rigid bodies, before and after the repair.

The driven joints of the world follow the compiled chain; tip and tool come from the bodies, as in training. The gripper is a
point mass, as in the equation of ``gripper_sway`` (difference to a rigid one: ``docs/world.md``), and the ground lies deep,
since a compiled plant has none.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.errors import SettingsError
from sysid.gap.localise import run_rmse
from sysid.gap.result import Gap, WorldGap
from sysid.plant import Plant, compile_plant, free_run
from sysid.progress import Progress, silent

Array = npt.NDArray[np.float64]

#: Total duration of the recordings that are run [s]; a minute takes one and a half seconds.
MAX_SECONDS = 600.0
#: Height of the ground, out of reach [m].
GROUND = -100.0


def world_gap(
    before: Plant, after: Plant, recordings: Sequence[Recording], floor: Mapping[str, float], progress: Progress = silent
) -> WorldGap:
    """RMSE of every measured signal in the world and of the compiled plant, on the same rows.

    Recordings that cannot be run are left out; ``skipped`` gives the reason.

    Args:
        recordings: held out; with the measured signals.
        floor: noise floor by signal.
    """
    begin = time.perf_counter()
    chosen, runs, reasons = _within(recordings), list[tuple[Recording, list[pd.DataFrame]]](), list[str]()
    for k, recording in enumerate(chosen):
        progress(k / len(chosen), f"PyBullet world: {recording.name}")
        try:
            there = [_in_world(before, recording)]
            there += there if after is before else [_in_world(after, recording)]
        except SettingsError as error:
            reasons.append(str(error).removeprefix("PyBullet world: "))
            continue
        compiled = [free_run(compile_plant(plant), recording) for plant in (before, after)]
        runs.append((recording, _on_same_rows([*there, *compiled])))
    if len(chosen) < len(recordings):
        reasons.append(f"{len(recordings) - len(chosen)} more recordings than {MAX_SECONDS:.0f} s")
    scores = [run_rmse([(recording, tables[k]) for recording, tables in runs]) for k in range(4)]
    shared = [signal for signal in scores[0] if all(signal in score for score in (*scores, floor))]
    world_before, world_after, plain_before, plain_after = ({s: score[s] for s in shared} for score in scores)
    floors = {s: floor[s] for s in shared}
    return WorldGap(
        Gap(world_before, world_after, floors),
        Gap(plain_before, plain_after, floors),
        tuple(recording.name for recording, _ in runs),
        time.perf_counter() - begin,
        "; ".join(dict.fromkeys(reasons)),
    )


def _within(recordings: Sequence[Recording]) -> list[Recording]:
    """The first recordings up to :data:`MAX_SECONDS`, at least one."""
    seconds = np.cumsum([len(r) / r.rate_hz for r in recordings])
    return [r for k, r in enumerate(recordings) if k == 0 or seconds[k] <= MAX_SECONDS]


def _in_world(plant: Plant, recording: Recording) -> pd.DataFrame:
    from sysid.world import World

    with World(plant, recording.rate_hz, gripper="point", ground=GROUND) as world:
        return world.rollout(recording)


def _on_same_rows(tables: Sequence[pd.DataFrame]) -> list[pd.DataFrame]:
    """The signals that all tables contain, NaN wherever one of them has no value."""
    shared = [name for name in tables[0].columns if all(name in table for table in tables)]
    values = np.array([table[shared].to_numpy(dtype=np.float64) for table in tables])
    there = np.isfinite(values).all(axis=0)
    return [pd.DataFrame(np.where(there, of_table, np.nan), columns=shared) for of_table in values]
