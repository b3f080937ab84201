"""Background: computes the initial points of a full scene's static background from clean plates (images of the
background without the subject)."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.formats.ply import ColouredPoints, read_ply, write_ply
from fourd.base.progress import Log
from fourd.pipeline.stage import Artefact, Context, Leftovers, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.plates import MATTE_PATTERNS, PLATE_PATTERNS
from fourd.pipeline.workload import Workload
from fourd.reconstruction.background.from_stereo import seed_from_stereo
from fourd.reconstruction.background.holes import fill_holes, measure_coverage
from fourd.reconstruction.background.plate_changes import find_changing_backgrounds
from fourd.reconstruction.background.plates import PlateView
from fourd.reconstruction.background.radiance.config import RadianceConfig
from fourd.reconstruction.background.radiance.from_radiance import seed_from_radiance
from fourd.reconstruction.background.shell import build_shell, direction_coverage
from fourd.reconstruction.training.cameras.measured_colours import (
    MeasuredColours,
    corrects_colours,
    read_measured_colours,
)
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.points.near_plane import (
    fallback_near,
    feature_near,
    is_before_near,
    visible_depths,
    write_static_near,
)
from fourd.reconstruction.training.run import read_run_plates
from fourd.reconstruction.training.run_layout import BACKGROUND, NEAR, PLATES, POINTS
from fourd.recording.capture.focus import viewing_centre
from fourd.recording.stereo.depth_maps import StereoResult, reconstruct_surfaces

BACKGROUND_S = 170.0
"""Seconds to compute the background points of a full scene. Measured: 171 s for 20 plates of 512 x 512 pixels."""
FULL_COVERAGE = 0.995
"""Holes are filled if the points cover a smaller fraction of a plate than this."""


@dataclass(frozen=True)
class BackgroundFiles:
    """Inputs and output of the stage that computes the initial background points.

    Attributes:
        capture: the capture's folder.
        run: the run folder. The points are written to ``background/points.ply`` in it.
        seeds: PLY file with background points from the user. If None, the points are computed from the plates.
        adjusted: whether the run has adjusted cameras.
    """

    capture: Path
    run: Path
    seeds: Path | None
    adjusted: bool


@dataclass(frozen=True)
class BackgroundSettings:
    """Selected views and frames, and the keys of :class:`BackgroundConfig` that affect the initial points."""

    selection: DataSelection
    points: int
    seeding: Literal["ngp", "sfm"]
    radiance: RadianceConfig
    seed: int
    colours: bool | None = None
    near: float | None = None

    @classmethod
    def of(cls, train: TrainConfig) -> BackgroundSettings:
        """Take the settings from a training config."""
        config = train.background
        return cls(
            DataSelection.of(train),
            config.points,
            config.seeding,
            config.radiance,
            train.seed,
            train.refine.colours,
            train.near,
        )


def background_stage(
    files: BackgroundFiles, settings: BackgroundSettings
) -> Stage[BackgroundFiles, BackgroundSettings]:
    """Create the stage that computes the initial background points of a full scene."""
    inputs = [Artefact(files.capture, INPUT_PATTERNS + MATTE_PATTERNS + PLATE_PATTERNS)]
    if files.seeds is not None:
        inputs.append(Artefact(files.seeds.parent, (glob.escape(files.seeds.name),)))
    return Stage(
        "background",
        run_background,
        files,
        settings,
        inputs=tuple(inputs),
        outputs=(files.run / BACKGROUND / POINTS, files.run / BACKGROUND / NEAR),
        leftovers=(Leftovers(files.run / BACKGROUND, keep=(PLATES, f"{PLATES}.json")),),
        after=("adjust", "colours", "plates"),
        expected_s=_expected_s,
    )


def _expected_s(settings: BackgroundSettings, workload: Workload) -> float:
    return BACKGROUND_S


def run_background(files: BackgroundFiles, settings: BackgroundSettings, context: Context) -> None:
    """Compute and write the background points, unless their file already exists. Held-out views are not used."""
    target = files.run / BACKGROUND / POINTS
    if target.exists():
        return
    log = context.log
    with open_run_views(files.capture, settings.selection, files.run if files.adjusted else None) as views:
        cameras = views.capture.cameras
        if files.seeds is None:
            plates = read_run_plates(views.capture, views.training, files.run, log)
            _log_unstable(find_changing_backgrounds(views.capture, views.training, plates), log)
            measured = read_measured_colours(files.run)
            if measured is not None and corrects_colours(settings.colours, measured):
                plates = tuple(_to_scene_colours(measured, plate) for plate in plates)
    if files.seeds is not None:
        points = _read_seeds(files.seeds, settings.points, settings.seed)
        near = feature_near(visible_depths(camera, points.xyz) for camera in cameras)
    else:
        stereo = reconstruct_surfaces(plates, settings.seed, context.workers, context.track)
        near = feature_near(stereo.feature_depths)
        points = _find_points(plates, stereo, settings, near, context)
        points = _add_shell(points, [plate.camera for plate in plates], cameras, context)
        points = _drop_before_near(points, cameras, settings.near or near, context)
        points = _fill_holes(points, plates, settings.near or near or fallback_near(cameras), context)
    write_static_near(files.run, near)
    write_ply(target, points.xyz, points.rgb)


def _fill_holes(points: ColouredPoints, plates: Sequence[PlateView], near: float, context: Context) -> ColouredPoints:
    """Add points where a plate shows a surface, but no point is rendered."""
    before = measure_coverage(points, plates, near)
    if before.least >= FULL_COVERAGE:
        context.log(f"background: the points cover {before}")
        return points
    added = fill_holes(points, plates, near, context.track)
    filled = ColouredPoints(np.concatenate([points.xyz, added.xyz]), np.concatenate([points.rgb, added.rgb]))
    after = measure_coverage(filled, plates, near)
    context.log(
        f"background: the points cover {before}; "
        f"with {len(added.xyz)} points that fill holes from their borders, {after}"
    )
    return filled


def _drop_before_near(
    points: ColouredPoints, cameras: Sequence[Camera], near: float | None, context: Context
) -> ColouredPoints:
    """Remove points that would stand close before a camera, held-out cameras included. The surfaces that cameras see
    themselves are farther away, so such points are errors of the depths that other cameras give to a wall behind this
    camera."""
    if near is None:
        return points
    before = is_before_near(points.xyz, cameras, near)
    if before.any():
        context.log(f"background: {before.sum()} points less than {near:.3g} world units before a camera are removed")
    return ColouredPoints(points.xyz[~before], points.rgb[~before])


def _add_shell(
    points: ColouredPoints, cameras: list[Camera], rig: Sequence[Camera], context: Context
) -> ColouredPoints:
    """Add the shell, which fills the directions that no plate shows."""
    shell = build_shell(points, cameras, viewing_centre(cameras), context.track, rig)
    share = direction_coverage(points, viewing_centre(cameras), cameras)
    context.log(
        f"background: the plates cover {share:.0%} of all directions around the scene; "
        f"{len(shell.xyz)} points with extrapolated colours fill the rest"
    )
    return ColouredPoints(np.concatenate([points.xyz, shell.xyz]), np.concatenate([points.rgb, shell.rgb]))


def _to_scene_colours(measured: MeasuredColours, plate: PlateView) -> PlateView:
    """Correct the colours of a plate, so that the plates of all cameras agree."""
    colours = measured.maps[plate.name]
    rgb = (plate.rgb / 255.0 - colours[:, 3]) @ np.linalg.inv(colours[:, :3]).T
    return replace(plate, rgb=(rgb.clip(0, 1) * 255 + 0.5).astype(np.uint8))


def _log_unstable(shares: dict[str, float], log: Log) -> None:
    """Log cameras whose background changes over time.

    ``shares`` maps the name of each such camera to the fraction of changing pixels.
    """
    if not shares:
        return
    worst = max(shares, key=lambda name: shares[name])
    others = f" (and {len(shares) - 1} more)" if len(shares) > 1 else ""
    log(
        f"background: camera '{worst}'{others}: up to {shares[worst]:.0%} of the pixels outside the mattes change over "
        "time. The static background shows their mean, so moving objects are blurred; include them in the mattes"
    )


def _find_points(
    plates: tuple[PlateView, ...],
    stereo: StereoResult,
    settings: BackgroundSettings,
    near: float | None,
    context: Context,
) -> ColouredPoints:
    """Compute points on the surfaces that the plates show. The settings select the method. ``near`` is the depth of the
    near plane of the static surfaces, unless the settings contain one."""
    count, seed, log = settings.points, settings.seed, context.log
    if settings.seeding == "sfm":
        return seed_from_stereo(plates, stereo, count, seed=seed, log=log)
    near = near if settings.near is None else settings.near
    return seed_from_radiance(
        plates, stereo, count, settings.radiance, near=near, seed=seed, log=log, track=context.track
    )


def _read_seeds(path: Path, count: int, seed: int) -> ColouredPoints:
    """Read the points that the user provided. If there are more than ``count``, return a uniform random sample of
    them."""
    xyz, rgb = read_ply(path)
    if len(xyz) == 0:
        raise UserError(f"{path}: expected points of the background, got none; use another PLY")
    kept = np.random.default_rng(seed).permutation(len(xyz))[:count]
    return ColouredPoints(xyz[kept], rgb[kept])
