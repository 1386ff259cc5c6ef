from __future__ import annotations

import pytest

from motionkit.data.dataset import Dataset
from motionkit.evaluation.real import RealMotion


@pytest.fixture(scope="session")
def real(dataset: Dataset) -> RealMotion:
    """The recordings of the small dataset."""
    return RealMotion(dataset)
