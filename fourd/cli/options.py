"""Options that several commands share, each with its help text and its check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from fourd.base.errors import UserError
from fourd.base.parallel import core_count
from fourd.cli.outputs import READS

FRAMES_HELP = "Every S-th frame from A to B, B excluded. A and B are indices of frames in the capture, from 0."
VIEWS_HELP = "Names of cameras, separated by commas."
LPIPS_DEFAULT = "VGG-16 from torch.hub's cache, LPIPS from the installed package lpips or torchmetrics"


def describe(*sentences: str) -> Any:
    """Make a help text from several sentences.

    Long help texts are not docstrings, because tyro keeps the line breaks of docstrings.
    """
    return tyro.conf.arg(help=" ".join(sentences))


def option(metavar: str, default: str, text: str | None = None) -> Any:
    """Make an option whose default is computed after parsing. --help shows the text ``default`` as the default."""
    return tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint=f"(default: {default})")


CapturePath = tyro.conf.Positional[Annotated[Path, READS, tyro.conf.arg(metavar="CAPTURE")]]
ScenePath = tyro.conf.Positional[Annotated[Path, READS, tyro.conf.arg(metavar="SCENE")]]
RunPath = tyro.conf.Positional[Annotated[Path, READS, tyro.conf.arg(metavar="RUN")]]
Views = Annotated[str | None, option("NAME,NAME", "all", VIEWS_HELP)]
ExcludedViews = Annotated[
    str | None, option("NAME,NAME", "none", "Names of cameras that are not used, separated by commas.")
]
Frames = Annotated[str | None, option("A:B[:S]", "all", FRAMES_HELP)]
FramesPerSecond = Annotated[
    float | None,
    option(
        "FLOAT",
        "unknown, plays at 30",
        "Frames per second of a capture that consists of images. Video files contain their own frame times.",
    ),
]
Workers = Annotated[int | None, option("N", "one per core", "Number of processes.")]
LpipsWeights = Annotated[
    Path | None,
    READS,
    option("PATH", LPIPS_DEFAULT, "File or folder with the weights of VGG-16 and LPIPS."),
]


OFFSET_HELP = (
    "Number of frames by which events appear later in the video of camera CAM than in the other videos. "
    "Fractions are allowed. Example for two cameras: cam02=3,cam05=-1.5."
)
SOUNDTRACK_HELP = (
    "Sound of the scene. auto: the best soundtrack of the videos, which is not silent, not clipped, of a high sampling "
    "rate, and loud. CAM: the soundtrack of this camera. FILE: a sound file or a video, whose sound begins at frame 0 "
    "of the capture. none: no sound."
)
TIER_HELP = (
    "full: images look like those of the unpacked scene.",
    "stream: coarser quantisation than full; a player fetches only the source views that it needs.",
    "video: like stream, but VP9 images store the colours of source views; files are smaller and decode more slowly.",
    "light: no source views; spherical harmonics contain all colours.",
)
MaxMbps = Annotated[
    float | None,
    option("FLOAT", "no limit", "Choose the best tier and level for a connection of this many megabits per second."),
]

StyleName = Annotated[
    str | None,
    option(
        "{toon,xtoon,gooch,ink,FILE.yaml}",
        "the captured colours",
        "Draw images in the style of a cartoon or a drawing: a preset, or a style file (docs/guides/stylize.md).",
    ),
]


PageStyles = Annotated[
    tyro.conf.UseAppendAction[tuple[Path, ...]],
    READS,
    option(
        "FILE.yaml",
        "none",
        "A style that the page offers in addition to the presets. Repeat the option for several styles.",
    ),
]


def check_mbps(max_mbps: float | None) -> None:
    """Raise UserError unless ``max_mbps`` is None or a number above 0 and below 1e9."""
    if max_mbps is not None and not 0 < max_mbps < 1e9:
        raise UserError(f"--max-mbps: expected a number of megabits per second above 0, got {max_mbps}")


HullAgreement = Annotated[
    float,
    describe(
        "Minimum share of mattes that must contain a point of the hull, in (0, 1]. Choose a lower share if mattes have",
        "holes.",
    ),
]
HullLeastViews = Annotated[
    float,
    describe(
        "Minimum share of all views that must see a point of the hull, in (0, 1]. Choose a lower share if each camera",
        "sees only a part of the scene.",
    ),
]


def check_hull_shares(agreement: float, least_views: float) -> None:
    """Raise UserError if one of the fractions is not in (0, 1]."""
    for name, share in (("agreement", agreement), ("least-views", least_views)):
        if not 0 < share <= 1:
            raise UserError(f"--{name}: expected a share in (0, 1], got {share:g}")


@dataclass(frozen=True)
class SelectionOptions:
    """Which cameras and frames of the capture the command uses."""

    views: Views = None
    exclude_views: ExcludedViews = None
    frames: Frames = None

    @property
    def names(self) -> tuple[str, ...] | None:
        """The cameras that the options select; None selects all cameras."""
        return chosen_views(self.views, self.exclude_views)


def check_rendering(
    layers: int | None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    size: tuple[int, int] | None = None,
    steps: int | None = None,
    fps: float | None = None,
) -> None:
    """Raise UserError for a rendering option that is out of range. Options whose value is None are not checked."""
    if layers is not None and not 1 <= layers <= 64:
        raise UserError(f"--layers: expected 1 to 64, got {layers}")
    if any(not 0 <= value <= 1 for value in background):
        raise UserError(f"--background: expected three numbers from 0 to 1, got {background}")
    if size is not None and not all(16 <= side <= 16384 for side in size):
        raise UserError(f"--size: expected 16 to 16384 pixels, got {size[0]} x {size[1]}")
    if steps is not None and steps < 1:
        raise UserError(f"--steps: expected at least 1, got {steps}")
    if fps is not None and not 0 < fps <= 1000:
        raise UserError(f"--fps: expected more than 0 and at most 1000, got {fps:g}")


def chosen_views(views: str | None, excluded: str | None) -> tuple[str, ...] | None:
    """Return the names that --views or --exclude-views select, as
    :func:`~fourd.recording.capture.layout.select_views` takes them. None selects all cameras."""
    if excluded is None:
        return split_names(views)
    if views is not None:
        raise UserError("--views, --exclude-views: expected one of them, got both; remove one")
    names = split_names(excluded)
    if not names:
        raise UserError("--exclude-views: expected camera names, got none; write for example --exclude-views 05")
    return tuple(f"-{name}" for name in names)


def split_names(text: str | None) -> tuple[str, ...] | None:
    """Split names at commas; None stays None."""
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def parse_offsets(words: Sequence[str]) -> dict[str, float]:
    """Parse the values of --offset, each a list of CAM=FRAMES separated by commas. The result maps each CAM to its
    FRAMES."""
    from fourd.recording.capture.video_list import MAX_OFFSET

    found: dict[str, float] = {}
    for part in (part.strip() for word in words for part in word.split(",") if part.strip()):
        name, _, frames = part.rpartition("=")
        try:
            value = float(frames)
        except ValueError:
            value, name = 0.0, ""
        if not name or name in found or not abs(value) < MAX_OFFSET:
            raise UserError(f"--offset: expected CAM=FRAMES, each camera once, got '{part}'; write it as cam02=7")
        found[name] = int(value) if value == int(value) else value
    return found


def worker_count(workers: int | None) -> int:
    """Return ``workers``, or the number of available cores if ``workers`` is None."""
    if workers is None:
        return core_count()
    if workers < 1:
        raise UserError(f"--workers: expected at least 1, got {workers}; omit the option for one process per core")
    return workers
