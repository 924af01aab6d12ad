"""The filter of a force comparison is read from a stored result as it was written, with a notch and without."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from sysid.gap.result import ForceComparison
from sysid.reports import archive


@pytest.mark.parametrize("notch", [(), (15.0, 0.04, 0.1)])
def test_a_force_comparison_is_read_as_it_was_written(notch: tuple[float, ...]) -> None:
    written = ForceComparison("slide", 40.0, 100.0, 0.0005, notch)
    values = archive._numbers(json.loads(json.dumps({"forces": [asdict(written)]})))
    assert archive._many(ForceComparison, values["forces"]) == (written,)
