from __future__ import annotations

import pytest
from sample_crane import sample_dataset

from sysid.datasets.recording import Dataset


@pytest.fixture(scope="session")
def crane() -> Dataset:
    return sample_dataset(seconds=14.0)
