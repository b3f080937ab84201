"""Mattes: makes foreground mattes of all images, and a contact sheet with which the user can check the mattes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fourd.pipeline.stage import Artefact, Context, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.edited_mattes import kept_if_edited
from fourd.pipeline.stages.silhouettes import write_silhouettes
from fourd.pipeline.workload import Workload
from fourd.reconstruction.carving.matte_quality import measure_mattes
from fourd.recording.capture import Capture, open_capture
from fourd.recording.capture.layout import DERIVED, MATTES, camera_names, select_views
from fourd.recording.capture.video_index import index_capture
from fourd.recording.matting.contact_sheet import write_contact_sheet
from fourd.recording.matting.output import SHEET
from fourd.recording.matting.selection import Selection
from fourd.recording.matting.sequence import MatteSettings, make_mattes

COMBINING_METHODS = ("motion",)
"""Methods that combine the evidence of all cameras, so that each image influences the mattes of all cameras."""
MIN_SILHOUETTE_VIEWS = 8
"""Minimum number of cameras whose hull gives held-out cameras their mattes. The silhouettes of 8 cameras have an IoU of
0.94 with the true masks of two captures, those of 6 cameras 0.88 and 0.92, and those of 3 cameras 0.73 and 0.86."""
MATTE_S_PER_MP = 0.66
"""Seconds on one core to make the mattes of one megapixel of images. Measured: 273 s on 2 cores for 400 images of 2.1
megapixels."""
QUALITY = DERIVED / "matte_quality.json"
"""JSON file that records how well the mattes agree with visual hulls: three numbers for each camera in each of a few
frames; see ``fourd.reconstruction.carving.matte_quality.MatteQuality``."""


@dataclass(frozen=True)
class MatteFiles:
    """The capture folder. The mattes are written to ``.fourd/mattes/`` in it."""

    capture: Path


@dataclass(frozen=True)
class MatteStageSettings:
    """Selected views and frames, and the settings of matting.

    Attributes:
        views: names of the selected cameras, or None for all.
        frames: range of frames, or None for all frames.
        mattes: the settings of matting.
        held_out: names of the cameras, among ``views``, whose images must not influence the mattes of the others. If
            the method combines cameras, the mattes of these cameras are silhouettes of the hull of the other mattes.
    """

    views: tuple[str, ...] | None
    frames: str | None
    mattes: MatteSettings
    held_out: tuple[str, ...] = ()

    @property
    def separates(self) -> bool:
        """Whether mattes of held-out views should not be made together with the others."""
        return bool(self.held_out) and self.mattes.method in COMBINING_METHODS

    def split(self, capture: Path) -> tuple[tuple[str, ...] | None, tuple[str, ...]]:
        """Return the views whose images the mattes are made from, and the held-out views that get silhouettes: none if
        the others are too few."""
        if not self.separates:
            return self.views, ()
        names = select_views(self.views, camera_names(capture))
        used = tuple(name for name in names if name not in self.held_out)
        if len(used) < MIN_SILHOUETTE_VIEWS:
            return self.views, ()
        return used, tuple(name for name in names if name in self.held_out)


def mattes_stage(capture: Path, settings: MatteStageSettings) -> Stage[MatteFiles, MatteStageSettings]:
    """Create the stage that makes mattes for ``capture``, which must not contain masks from the user in masks/."""
    return Stage(
        "mattes",
        run_mattes,
        MatteFiles(capture),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS),),
        outputs=(capture / SHEET,),
        expected_s=_expected_s,
    )


def _expected_s(settings: MatteStageSettings, workload: Workload) -> float:
    pictures_mp = workload.cameras * workload.known_frames * workload.megapixels
    return MATTE_S_PER_MP * pictures_mp / workload.workers


def run_mattes(files: MatteFiles, settings: MatteStageSettings, context: Context) -> None:
    """Make the missing mattes, and then the contact sheet. Mattes that an earlier call made with the same settings are
    kept."""
    path = files.capture
    used, held_out = settings.split(path)
    if settings.separates and not held_out:
        names = ", ".join(settings.held_out)
        context.log(
            f"{path}: the mattes are made from all cameras, with the held-out images of {names}: silhouettes of the "
            f"hull of fewer than {MIN_SILHOUETTE_VIEWS} other cameras are too large to score views with"
        )
    selection = Selection(path, used, settings.frames)
    index_capture(path, settings.views, context.track)
    with kept_if_edited(path, context.log):
        made = make_mattes(selection, settings.mattes, context.workers, context.track)
    context.log(f"{path}: made mattes of {made} frames; kept the mattes of the other frames")
    if held_out:
        made += _make_silhouettes(selection, held_out, context)
    sheet = path / SHEET
    if made or not sheet.exists():
        views = None if settings.views is None else list(settings.views)
        with open_capture(path, views=views, frames=settings.frames) as capture:
            independent = [index for index, name in enumerate(capture.names) if name not in held_out]
            write_quality(capture.select(independent), context)
            write_contact_sheet(capture, sheet, track=context.track)


def _make_silhouettes(given: Selection, held_out: Sequence[str], context: Context) -> int:
    """Make the missing mattes of held-out cameras from those of the other cameras, and return for how many frames."""
    folder = given.path / MATTES
    with given.open(mattes=False) as capture:
        names = capture.frame_names
    paths = [[folder / camera / f"{name}.png" for camera in held_out] for name in names]
    missing = [index for index, files in enumerate(paths) if not all(path.exists() for path in files)]
    write_silhouettes(given, held_out, missing, folder, context)
    context.log(
        f"{given.path}: the mattes of the held-out cameras {', '.join(held_out)} are the silhouettes of the visual "
        f"hull of the other mattes, which therefore owe nothing to held-out images ({len(missing)} frames made)"
    )
    return len(missing)


def write_quality(capture: Capture, context: Context) -> None:
    """Compare the mattes of a few frames with visual hulls, and write the results to QUALITY. If the visual
    hull of the other views covers only a small fraction of a matte, log a warning for this matte."""
    quality = measure_mattes(capture, track=context.track)
    if quality is None:
        return
    quality.save(capture.path / QUALITY)
    for line in quality.warnings():
        context.log(line)
