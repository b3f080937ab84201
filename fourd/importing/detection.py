"""The supported formats, and detection of a source's format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from fourd.errors import UserError
from fourd.importing.formats import (
    actorshq,
    anipose,
    colmap,
    dna_rendering,
    easymocap,
    neural3dv,
    qualisys,
    transforms_json,
    videos,
)
from fourd.importing.imported import Imported


@dataclass(frozen=True)
class Format:
    """One importer.

    Attributes:
        name: the format's name on the command line.
        summary: what a source contains, for help texts.
        looks_like: function that tests whether a path has this format, by reading only file names and the first bytes
            of files.
        read: function that reads the cameras of a source, and raises UserError for an invalid source.
    """

    name: str
    summary: str
    looks_like: Callable[[Path], bool]
    read: Callable[[Path], Imported]


FORMATS = (
    Format("qualisys", "NAME.qca.txt and one video per camera", qualisys.looks_like, qualisys.read),
    Format("anipose", "a calibration TOML of Anipose or Pose2Sim, and videos", anipose.looks_like, anipose.read),
    Format("neural3dv", "poses_bounds.npy and camNN.mp4", neural3dv.looks_like, neural3dv.read),
    Format("actorshq", "calibration.csv, rgbs/ and masks/", actorshq.looks_like, actorshq.read),
    Format("dna-rendering", "NAME.smc and NAME_annots.smc", dna_rendering.looks_like, dna_rendering.read),
    Format("transforms", "transforms.json and images", transforms_json.looks_like, transforms_json.read),
    Format("colmap", "a sparse model and each camera's video or images", colmap.looks_like, colmap.read),
    Format("easymocap", "intri.yml, extri.yml, images/CAM/ or videos/", easymocap.looks_like, easymocap.read),
    Format("videos", "videos or folders of images, without a calibration", videos.looks_like, videos.read),
)
"""All formats in the order of detection: the most specific formats first."""


def pick_format(name: str | None, source: Path) -> Format:
    """Find the format called ``name``, or the first format that the source matches if ``name`` is None.

    Raises:
        UserError: when the source is missing, the name is unknown, or the source matches no format.
    """
    if not source.exists():
        raise UserError(f"{source}: expected files to import, but it does not exist; check the path")
    by_name = {each.name: each for each in FORMATS}
    if name is not None and name not in by_name:
        near = get_close_matches(name, by_name, 1)
        hint = f"did you mean '{near[0]}'?" if near else "omit it for automatic detection"
        raise UserError(f"FORMAT: expected one of {', '.join(by_name)}, got '{name}'; {hint}")
    found = by_name[name] if name is not None else next((each for each in FORMATS if each.looks_like(source)), None)
    if found is None:
        raise UserError(
            f"{source}: expected {', or '.join(f'{each.summary} ({each.name})' for each in FORMATS)}, "
            "got none of these; name the folder that contains such files"
        )
    return found
