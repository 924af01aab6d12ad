"""Recordings averaged to a lower rate, for stages that have no dynamics of their own between two samples.

Averages of a measured input are less noisy than its samples, so that a play or a saturation driven by it does not act as a
filter of its noise.
"""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from sysid.datasets.recording import Recording
from sysid.effects.effect import Stage
from sysid.gap.likelihood.rows import bin_means

#: Time over which inputs and outputs of a stage are averaged [s]; stages that are not named here keep their rate.
SPANS: dict[Stage, float] = {"joint": 0.1, "end_effector": 0.1}


def averaged(recording: Recording, stage: Stage) -> Recording:
    """The recording as the stage's regression sees it."""
    width = round(SPANS.get(stage, 0.0) * recording.rate_hz)
    if recording.kind != "motion" or width < 2:
        return recording
    values = recording.table.to_numpy(dtype=float)
    means = bin_means(values[None], width)[0]
    return replace(recording, table=pd.DataFrame(means, columns=recording.table.columns), rate_hz=recording.rate_hz / width)
