"""Random damage of files for tests of readers."""

from __future__ import annotations

import numpy as np


def damage(content: bytes, rng: np.random.Generator, most: int) -> bytes:
    """Return ``content`` with at least 1 and at most ``most`` - 1 changed bytes. In one of five cases, the content is
    also truncated at a random position.
    """
    changed = np.frombuffer(content, np.uint8).copy()
    where = rng.integers(0, len(changed), rng.integers(1, most))
    changed[where] = rng.integers(0, 256, len(where))
    end = len(changed) if rng.random() < 0.8 else int(rng.integers(len(changed)))
    return changed[:end].tobytes()
