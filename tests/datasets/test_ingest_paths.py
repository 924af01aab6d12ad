"""Where the logs are said to be."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.datasets import ingest
from sysid.errors import InputError


def test_a_path_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere: no such file or folder; expected a folder of recordings"):
        ingest(tmp_path / "nowhere", tmp_path / "workspace")
