"""Chooses the tier and level of a packed scene such that it plays without pauses over a network connection."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.progress import Track, untracked
from fourd.recording.capture.layout import sample_indices
from fourd.scene.files.encoding import Tier
from fourd.scene.packed.streams import Compression
from fourd.scene.packing.pack import measure_frames
from fourd.scene.packing.precision import LEVELS
from fourd.scene.splats.reader import open_reader

SAMPLED_FRAMES = 3
"""Number of frames from which the bytes per frame of a level (a set of quantisation steps) are estimated."""
MARGIN = 0.95
"""Maximum estimated data rate of a level, as a fraction of the connection's data rate. The rest is a reserve for frames
that are larger than the mean."""
WEB_MARGIN = 0.9
"""The value of MARGIN for web pages. It is lower because web pages request several frames at the same time."""


@dataclass(frozen=True)
class Choice:
    """The chosen level (set of quantisation steps) of a tier, and the data rates on which the choice is based.

    Attributes:
        tier, level: see :data:`fourd.scene.packing.precision.LEVELS`.
        mbps: estimated rate in megabits per second.
        finer_mbps: estimated rate of the next better level, for which the connection is too slow. None if no level is
            better.
        fps: frames per second of playback.
    """

    tier: Tier
    level: int
    mbps: float
    finer_mbps: float | None
    fps: float

    def __str__(self) -> str:
        why = "" if self.finer_mbps is None else f"; the next finer level needs {self.finer_mbps:.1f} Mbit/s"
        level = f"level {self.level + 1} of {len(LEVELS[self.tier])}"
        return f"tier {self.tier}, {level}: {self.mbps:.1f} Mbit/s at {self.fps:g} frames per second{why}"


LIGHT_FROM = 3
"""Index of the finest level of the tier "light" that can be chosen for a connection. Finer levels of "light" are not
needed, because some levels of the tier "stream" have about the same size and quality as they do."""
CANDIDATES: tuple[tuple[Tier, int], ...] = (
    *(("full", level) for level in range(len(LEVELS["full"]))),
    *(("stream", level) for level in range(len(LEVELS["stream"]))),
    *(("light", level) for level in range(LIGHT_FROM, len(LEVELS["light"]))),
)
"""Pairs of a tier and the index of one of its levels, from the largest files with the best quality to the smallest
files with the lowest quality. :func:`choose_tier` chooses the first pair whose data rate is low enough for the
connection."""


def choose_tier(
    source: Path, max_mbps: float, name: Path, track: Track = untracked, *, for_web: bool = False
) -> Choice:
    """Choose the best tier and level that one viewer can play without pauses over a connection of ``max_mbps`` megabits
    per second.

    Args:
        source: a `.4dv` of any version.
        max_mbps: rate of the connection.
        name: the file that the error message names; ``source`` itself may be a temporary file.
        track: reports progress.
        for_web: whether the scene is played by a web page, which needs the compression "zlib" and the margin
            WEB_MARGIN.

    Raises:
        UserError: if even the smallest level needs a higher rate, or if ``source`` is not a valid scene.
    """
    compression: Compression = "zlib" if for_web else "zstd"
    margin = WEB_MARGIN if for_web else MARGIN
    reader = open_reader(source)
    try:
        count, fps = reader.manifest.frame_count, reader.manifest.fps
        frames = sample_indices(count, SAMPLED_FRAMES)
        mbps: float | None = None
        for tier, level in track(CANDIDATES, len(CANDIDATES), "measure"):
            finer = mbps
            mbps = measure_frames(reader, frames, tier, level, compression) * fps * 8 / 1e6
            if mbps <= margin * max_mbps:
                return Choice(tier, level, mbps, finer, fps)
    finally:
        reader.close()
    assert mbps is not None
    raise UserError(
        f"--max-mbps: expected at least {mbps / margin:.1f} Mbit/s for {name} at {fps:g} frames per second, "
        f"got {max_mbps:g}; use a faster connection, or train with fewer points"
    )
