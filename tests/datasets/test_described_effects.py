"""Effects in ``machine.toml`` are checked at ingest, before a log is read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from one_axis_logs import MACHINE, record

from sysid.datasets import Store, ingest
from sysid.errors import SettingsError

EFFECT = '\n[[effects]]\nname = "valve_deadband"\ntarget = "a"\nparameters = { positive = 0.1, negative = 0.1 }\n'


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("valve_deadband", "valve_dedband", "unknown effect 'valve_dedband'; expected 'valve_deadband'?"),
        ('target = "a"', 'target = "aa"', "unknown axis 'aa'; expected 'a'?"),
        ("positive =", "positiv =", "'positiv' is no parameter: 'positive'?"),
        ("negative = 0.1", "negative = 7.0", "negative = 7.0; expected a number in [0.0, "),
    ],
)
def test_mistakes_in_effects_stop_the_ingest(tmp_path: Path, before: str, after: str, message: str) -> None:
    assert before in EFFECT
    logs = tmp_path / "logs"
    for seed in range(3):
        record(logs / f"run-{seed}", seed)
    description = tmp_path / "machine.toml"
    description.write_text(MACHINE + EFFECT.replace(before, after), "utf-8")
    with pytest.raises(SettingsError, match=re.escape(message)):
        ingest(logs, tmp_path / "workspace", machine=description)
    assert not Store(tmp_path / "workspace").list()


def test_the_stream_of_a_clock_effect_is_not_known_before_the_logs_are_read(tmp_path: Path) -> None:
    for seed in range(3):
        record(tmp_path / "logs" / f"run-{seed}", seed)
    effect = '\n[[effects]]\nname = "clock_offset"\ntarget = "capture"\nparameters = { offset = 0.01 }\n'
    (tmp_path / "machine.toml").write_text(MACHINE + effect, "utf-8")
    assert ingest(tmp_path / "logs", tmp_path / "workspace", machine=tmp_path / "machine.toml").version == 1
