"""The supported formats, and detection of a source's format and layout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

from fourd.base.errors import UserError
from fourd.recording.importing.formats import (
    actorshq,
    anipose,
    caliscope,
    colmap,
    dna_rendering,
    easymocap,
    neural3dv,
    panoptic_sports,
    qualisys,
    transforms_json,
    videos,
)
from fourd.recording.importing.imported import Imported
from fourd.recording.importing.layouts import (
    MAX_LISTED,
    CalibrationFormat,
    Frames,
    Layout,
    describe_refused,
    find_calibration,
    find_layout,
)


@dataclass(frozen=True)
class Format:
    """An input format of ``fourd import``, with the functions that detect and read sources in this format.

    Attributes:
        name: the format's name on the command line.
        summary: content of a source in this format, for help texts.
        looks_like: function that tests whether a path has this format, by reading only file names and the first bytes
            of files.
        read: function that reads the cameras of a source, and raises UserError for an invalid source.
        is_metric: whether the calibrations are in metres, so that distances can be converted to the travel time of
            sound.
    """

    name: str
    summary: str
    looks_like: Callable[[Path], bool]
    read: Callable[[Path], Imported]
    is_metric: bool = False


FORMATS = (
    Format("qualisys", "NAME.qca.txt and one video per camera", qualisys.looks_like, qualisys.read, is_metric=True),
    Format(
        "caliscope", "camera_array.toml of Caliscope, and videos", caliscope.looks_like, caliscope.read, is_metric=True
    ),
    Format(
        "anipose",
        "a calibration TOML of Anipose, Pose2Sim or FreeMoCap, and videos",
        anipose.looks_like,
        anipose.read,
        is_metric=True,
    ),
    Format("neural3dv", "poses_bounds.npy and camNN.mp4", neural3dv.looks_like, neural3dv.read),
    Format(
        "panoptic-sports",
        "train_meta.json, ims/ and seg/ of Dynamic 3D Gaussians",
        panoptic_sports.looks_like,
        panoptic_sports.read,
    ),
    Format("actorshq", "calibration.csv, rgbs/ and masks/", actorshq.looks_like, actorshq.read, is_metric=True),
    Format(
        "dna-rendering", "NAME.smc and NAME_annots.smc", dna_rendering.looks_like, dna_rendering.read, is_metric=True
    ),
    Format("transforms", "transforms.json and images", transforms_json.looks_like, transforms_json.read),
    Format("colmap", "a sparse model and each camera's video or images", colmap.looks_like, colmap.read),
    Format("easymocap", "intri.yml, extri.yml, images/CAM/ or videos/", easymocap.looks_like, easymocap.read),
    Format("videos", "videos or folders of images, without a calibration", videos.looks_like, videos.read),
)
"""All formats in the order of detection: the most specific formats first."""

CALIBRATION_FORMATS = (
    CalibrationFormat("qualisys", qualisys.is_calibration, qualisys.read, qualisys.read_names),
    CalibrationFormat("caliscope", caliscope.is_calibration, caliscope.read, caliscope.read_names),
    CalibrationFormat("anipose", anipose.is_calibration, anipose.read, anipose.read_names),
    CalibrationFormat("easymocap", easymocap.is_calibration, easymocap.read, easymocap.read_names),
)
"""Formats whose calibration and frames may be in different folders. Earlier formats are preferred."""
VIDEOS = "videos"


def pick_format(name: str | None, source: Path) -> Format:
    """Find the format called ``name``, or the first format that the source matches if ``name`` is None.

    If the calibration and the frames of the source are in different folders, the result's ``read`` reads both; see
    :func:`~fourd.recording.importing.layouts.find_layout`.

    Raises:
        UserError: when the source is missing, the name is unknown, or the source matches no format.
    """
    if not source.exists():
        raise UserError(f"{source}: expected files to import, got a path that does not exist; check the path")
    by_name = {each.name: each for each in FORMATS}
    if name is not None and name not in by_name:
        near = get_close_matches(name, by_name, 1)
        hint = f"did you mean '{near[0]}'?" if near else "omit it for automatic detection"
        raise UserError(f"FORMAT: expected one of {', '.join(by_name)}, got '{name}'; {hint}")
    calibrated = [each.name for each in CALIBRATION_FORMATS]
    if name is not None and name not in calibrated:
        return by_name[name]
    direct = next((each for each in FORMATS if name in (None, each.name) and each.looks_like(source)), None)
    if direct is not None and direct.name != VIDEOS and (direct.name not in calibrated or _has_frames(source)):
        return direct
    found = find_layout(source, [each for each in CALIBRATION_FORMATS if name in (None, each.name)])
    if isinstance(found, Layout):
        return replace(by_name[found.format.name], read=found.read)
    if isinstance(found, Frames) and name is None:
        return replace(by_name[VIDEOS], read=lambda _: _read_videos(source, found))
    lonely = find_calibration(source, [each for each in CALIBRATION_FORMATS if name in (None, each.name)])
    if lonely is not None and found is None:
        raise UserError(_without_frames(source, *lonely))
    if name is not None:
        return by_name[name]
    refused = describe_refused(source, CALIBRATION_FORMATS)
    raise UserError(
        f"{source}: expected {', or '.join(f'{each.summary} ({each.name})' for each in FORMATS)}, "
        f"got none of these{f' ({refused})' if refused else ''}; name the folder that contains such files"
    )


def _without_frames(source: Path, form: CalibrationFormat, path: Path) -> str:
    """Return the message for a calibration without a recording."""
    folder = path.parent if form.name == "caliscope" else source if source.is_dir() else source.parent
    place = folder / ("recordings/NAME" if form.name == "caliscope" else "videos")
    names = list(form.names(path))
    listed = ", ".join(f"{name}.mp4" for name in names[:MAX_LISTED]) + (", ..." if len(names) > MAX_LISTED else "")
    return (
        f"{source}: expected a recording beside the calibration {path} ({form.name}, {len(names)} cameras), got no "
        f"videos or images outside the folders of calibrations; add the recording's videos {listed} in {place}/"
    )


def _has_frames(source: Path) -> bool:
    """Return whether the folder of a calibration also contains frames."""
    return videos.looks_like(source if source.is_dir() else source.parent)


def _read_videos(source: Path, found: Frames) -> Imported:
    imported = videos.read(found.folder)
    return Imported(imported.cameras, (*found.notes(source), *imported.notes))
