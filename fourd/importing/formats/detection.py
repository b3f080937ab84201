"""The formats there are, and which one a source is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

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
from fourd.importing.formats.imported import Imported


@dataclass(frozen=True)
class Format:
    """One importer.

    Attributes:
        name: as the command line has it.
        summary: what a source holds, for help texts.
        looks_like: whether a path is such a source, told from names and first bytes alone.
        read: the cameras of a source; raises UserError.
    """

    name: str
    summary: str
    looks_like: Callable[[Path], bool]
    read: Callable[[Path], Imported]


FORMATS = (
    Format("qualisys", "NAME.qca.txt and a video of each camera", qualisys.looks_like, qualisys.read),
    Format("anipose", "a calibration TOML (also Pose2Sim's) and videos", anipose.looks_like, anipose.read),
    Format("neural3dv", "poses_bounds.npy and camNN.mp4", neural3dv.looks_like, neural3dv.read),
    Format("actorshq", "calibration.csv, rgbs/ and masks/", actorshq.looks_like, actorshq.read),
    Format("dna-rendering", "NAME.smc and NAME_annots.smc", dna_rendering.looks_like, dna_rendering.read),
    Format("transforms", "transforms.json and pictures", transforms_json.looks_like, transforms_json.read),
    Format("colmap", "a sparse model and each camera's video or pictures", colmap.looks_like, colmap.read),
    Format("easymocap", "intri.yml, extri.yml, images/CAM/ or videos/", easymocap.looks_like, easymocap.read),
    Format("videos", "videos or folders of pictures, no calibration", videos.looks_like, videos.read),
)
"""In the order in which a source is tried: the most specific first."""
