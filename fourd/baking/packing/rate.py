"""Selects the best tier of a packed scene that plays without pauses over a given network connection."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.baking.container import SceneReader
from fourd.baking.files.encoding import Tier
from fourd.baking.packing.pack import measure_frames
from fourd.errors import UserError

SAMPLED_FRAMES = 3
"""Number of frames from which the bytes per frame of a tier are estimated."""
MARGIN = 0.95
"""Share of the connection's data rate that the estimated data rate may use. The rest is for frames that are larger than
the mean."""


@dataclass(frozen=True)
class Choice:
    """A tier, the factor that multiplies its quantisation steps, and its estimated data rate in megabits per second."""

    tier: Tier
    coarseness: int
    mbps: float


CANDIDATES: tuple[tuple[Tier, int], ...] = (
    ("full", 1),
    ("stream", 1),
    ("stream", 2),
    ("light", 1),
    ("light", 2),
    ("light", 4),
)
"""Pairs of a tier and the factor that multiplies its quantisation steps, from the best to the smallest scene."""


def choose_tier(source: Path, max_mbps: float, name: Path) -> Choice:
    """Return the best pair in CANDIDATES whose data rate for one viewing camera is at most ``MARGIN * max_mbps``
    megabits per second.

    ``name`` is the file name in the error message, because ``source`` may be a temporary file.

    Raises:
        UserError: if even the smallest candidate has a higher data rate, or if ``source`` is not a valid scene.
    """
    reader = SceneReader(source)
    try:
        count, fps = reader.manifest.frame_count, reader.manifest.fps
        frames = sorted({round(index * (count - 1) / max(SAMPLED_FRAMES - 1, 1)) for index in range(SAMPLED_FRAMES)})
        choice = Choice("full", 1, 0.0)
        for tier, coarseness in CANDIDATES:
            mbps = measure_frames(reader, frames, tier, coarseness) * fps * 8 / 1e6
            choice = Choice(tier, coarseness, mbps)
            if mbps <= MARGIN * max_mbps:
                return choice
    finally:
        reader.close()
    raise UserError(
        f"--max-mbps: expected at least {choice.mbps / MARGIN:.1f} Mbit/s for {name} at {fps:g} frames per second, "
        f"got {max_mbps:g}; use a faster connection, or train with fewer points"
    )
