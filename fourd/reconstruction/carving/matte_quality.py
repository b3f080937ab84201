"""Detection of poor mattes. A matte is poor if the visual hull of the other views covers too small a part of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.json_file import read_json_as
from fourd.base.progress import Track, untracked
from fourd.reconstruction.carving.coherence import frame_coherence
from fourd.recording.capture.layout import sample_indices
from fourd.recording.capture.pictures.mask_source import MaskSource, frame_masks

POOR = 0.7
"""A matte is reported as poor if the hull of the other views covers less than this fraction of it."""
MIN_KEPT = 1 / 3
"""An error is raised if the hull of all views covers less than this fraction of the mattes' area."""
MAX_FRAMES = 48
MAX_LINES = 8
MAX_LINE = 1000
"""Maximum number of characters of a line that is read from a file."""


@dataclass(frozen=True, eq=False)
class MatteQuality:
    """How well a capture's mattes match the visual hulls, measured in some of its frames.

    Attributes:
        names: camera names.
        frames: frame numbers (F,) of the measured frames, as in the capture.
        explained: (F, C) fraction of each matte that the hull of the other views covers, or NaN for an empty matte.
        kept: (F, C) fraction of each matte that the hull of all views covers, or NaN for an empty matte.
        overlap: (F, C) intersection over union of each matte and the silhouette of the hull of all views, or NaN for an
            empty matte.
        area: (F, C) fraction of the image that each matte covers.
    """

    names: tuple[str, ...]
    frames: tuple[int, ...]
    explained: NDArray[np.float64]
    kept: NDArray[np.float64]
    overlap: NDArray[np.float64]
    area: NDArray[np.float64]

    @property
    def kept_share(self) -> float:
        """Fraction of the mattes' area that the hull of all views covers, or 1 if all mattes are empty."""
        total = float(self.area.sum())
        return float(np.nansum(self.kept * self.area)) / total if total else 1.0

    def warnings(self) -> list[str]:
        """Return one line of text for each run of consecutive frames in which the mattes of one view are poor. The line
        with the smallest covered fraction comes first."""
        found = sorted(self._poor_runs())
        lines = [
            f"{name}, {_frame_range(first, last)}: the hull of the other views covers {share:.0%} of this matte"
            for share, name, first, last in found[:MAX_LINES]
        ]
        if len(found) > MAX_LINES:
            lines.append(f"and {len(found) - MAX_LINES} more views and frames with poor mattes")
        return lines

    def _poor_runs(self) -> Iterator[tuple[float, str, int, int]]:
        """Yield one tuple for each run of consecutive frames in which the mattes of one view are poor: mean covered
        fraction, camera name, first frame and last frame."""
        for index, name in enumerate(self.names):
            poor = self.explained[:, index] < POOR
            starts = np.flatnonzero(poor & ~np.r_[False, poor[:-1]])
            ends = np.flatnonzero(poor & ~np.r_[poor[1:], False])
            for start, end in zip(starts, ends, strict=True):
                share = float(np.mean(self.explained[start : end + 1, index]))
                yield share, name, self.frames[start], self.frames[end]

    def require_hull(self, path: Path, cause: str = "") -> None:
        """Raise UserError if the hull covers less than a third of the mattes' area. The message names the possible
        ``cause``, if there is one."""
        if self.kept_share >= MIN_KEPT:
            return
        worst = next(iter(self.warnings()), "no view is much worse than the others")
        also = f"{cause}; otherwise, " if cause else ""
        raise UserError(
            f"{path}: expected mattes of which the visual hull covers at least a third, got {self.kept_share:.0%} "
            f"({worst}); {also}fix the mattes (docs/matting.md) or the calibration, or "
            "continue with --accept-mattes"
        )

    def save(self, path: Path) -> None:
        """Write the fractions to a JSON file, with null for empty mattes. See :func:`read_hull_share`."""
        tables = {
            name: [[None if np.isnan(value) else round(float(value), 4) for value in row] for row in table]
            for name, table in (("explained", self.explained), ("kept", self.kept), ("overlap", self.overlap))
        }
        share, poor = round(self.kept_share, 4), self.warnings()
        content = {"version": 1, "cameras": self.names, "frames": self.frames, "kept_share": share, "poor": poor}
        text = json.dumps({**content, **tables})
        write_text_atomically(path, text + "\n")


@dataclass(frozen=True)
class HullShare:
    """How much of a run's mattes the visual hull covers.

    Attributes:
        kept_share: fraction of the mattes' area that the hull of all views covers.
        poor: one line of text for each run of frames with poor mattes of one view, the worst first.
    """

    kept_share: Annotated[float, Meta(ge=0, le=1)]
    poor: tuple[Annotated[str, Meta(max_length=MAX_LINE)], ...]


def read_hull_share(path: Path) -> HullShare | None:
    """Read the file that :meth:`MatteQuality.save` wrote. Returns None if it is missing or damaged."""
    try:
        return read_json_as(path, HullShare)
    except (OSError, ValueError, UserError):
        return None


def measure_mattes(
    capture: MaskSource,
    *,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
    max_frames: int = MAX_FRAMES,
    track: Track = untracked,
) -> MatteQuality | None:
    """Measure how well the mattes agree with the visual hull, in at most ``max_frames`` evenly spaced frames of a
    capture.

    The result is None for fewer than three cameras: two silhouettes nearly always have a common hull, so their
    agreement does not show whether the mattes are correct. Frames are read one at a time.
    """
    if len(capture.cameras) < 3 or capture.frame_count == 0:
        return None
    frames = sample_indices(capture.frame_count, max_frames)
    found = [
        frame_coherence(frame_masks(capture, frame), capture.cameras, agreement=agreement, least_views=least_views)
        for frame in track(frames, len(frames), "comparing mattes with their hull")
    ]
    return MatteQuality(
        tuple(capture.names),
        tuple(capture.frame_numbers[frame] for frame in frames),
        np.stack([each.explained for each in found]),
        np.stack([each.kept for each in found]),
        np.stack([each.overlap for each in found]),
        np.stack([each.area for each in found]),
    )


def _frame_range(first: int, last: int) -> str:
    return f"frame {first}" if first == last else f"frames {first} to {last}"
