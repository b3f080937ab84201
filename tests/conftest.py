"""What all tests share: seeds that are fresh, printed, and can be set again."""

from __future__ import annotations

import os
import secrets

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fresh seed, printed with a failing test; FOURD_TEST_SEED sets it again."""
    seed = int(os.environ.get("FOURD_TEST_SEED", secrets.randbits(32)))
    print(f"FOURD_TEST_SEED={seed}")
    return np.random.default_rng(seed)
