"""What all tests share: seeds that are fresh, printed, and can be set again."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

import numpy as np
import pytest

from tests.captures import write_ball_capture


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fresh seed, printed with a failing test; FOURD_TEST_SEED sets it again."""
    seed = int(os.environ.get("FOURD_TEST_SEED", secrets.randbits(32)))
    print(f"FOURD_TEST_SEED={seed}")
    return np.random.default_rng(seed)


@pytest.fixture(scope="session")
def ball_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of a striped ball: 8 cameras, 3 frames, 64 x 64. Not to be changed by tests."""
    return write_ball_capture(tmp_path_factory.mktemp("ball"), frames=3)
