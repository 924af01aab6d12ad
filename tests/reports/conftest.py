from __future__ import annotations

import pytest
from sample_crane import sample_dataset

from sysid.datasets.recording import Dataset
from sysid.machine import Machine


@pytest.fixture(scope="session")
def crane() -> Dataset:
    return sample_dataset()


@pytest.fixture(scope="session")
def crane_machine(crane: Dataset) -> Machine:
    return crane.machine
