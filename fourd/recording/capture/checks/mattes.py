"""What the decoded mattes of a capture show: empty, white and inverted mattes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

MIN_COVERAGE = 1e-4
MAX_COVERAGE = 0.98
MAX_MEAN_COVERAGE = 0.6


@dataclass
class MatteTally:
    """Mean values of the decoded mattes of all cameras.

    Attributes:
        coverages: mean matte value as a fraction of white, by file.
    """

    coverages: dict[Path, float] = field(default_factory=dict)

    def add(self, file: Path, matte: NDArray[np.uint8]) -> None:
        """Add a decoded matte (H, W)."""
        self.coverages[file] = float(matte.mean()) / 255

    @property
    def mean(self) -> float | None:
        """Mean coverage of the decoded mattes, or None if no matte was decoded."""
        return float(np.mean(list(self.coverages.values()))) if self.coverages else None

    @property
    def is_empty(self) -> bool:
        """Whether mattes were decoded, and all of them are empty."""
        return bool(self.coverages) and max(self.coverages.values()) < MIN_COVERAGE

    def warnings(self) -> Iterator[str]:
        """Yield one line for each camera with empty mattes, one for each camera with white mattes, and one line if the
        mattes of all cameras cover most of the images."""
        for folder in sorted({file.parent for file in self.coverages}):
            own = {file: share for file, share in self.coverages.items() if file.parent == folder}
            empty = sorted(file for file, share in own.items() if share < MIN_COVERAGE)
            white = sorted(file for file, share in own.items() if share > MAX_COVERAGE)
            for files, got, fix in (
                (empty, "empty", "the object should be white"),
                (white, "entirely white", "they may be inverted (the object should be white)"),
            ):
                if files:
                    yield f"{folder}: {_count(len(files), len(own))} {got} (first: {files[0].name}); {fix}"
        mean = self.mean or 0.0
        if MAX_COVERAGE >= mean > MAX_MEAN_COVERAGE:
            yield (
                f"{folder.parent}: mattes cover {mean:.0%} of the images; they may be inverted (the object should be "
                "white)"
            )


def _count(some: int, total: int) -> str:
    if some < total:
        return f"{some} of {total} mattes are"
    return f"all {total} decoded mattes are" if total > 1 else "the matte is"
