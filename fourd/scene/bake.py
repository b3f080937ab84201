"""Export of a trained run to a scene file.

Export evaluates the networks for every frame, so that a program can render the scene file without the networks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from torch import Tensor

from fourd.base.errors import UserError
from fourd.base.progress import Track, Tracker, untracked
from fourd.base.version import __version__
from fourd.reconstruction.model import PointModel
from fourd.reconstruction.model.appearance import mix_own_colours, zero_low_visibility
from fourd.reconstruction.model.point_model import EvaluatedPoints
from fourd.reconstruction.model.sources import OCCLUSION_FALLOFF_SPACINGS, SourceViews, sample_sources
from fourd.reconstruction.training.occlusion import with_surface_depth
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.run import Run, TrainedRun
from fourd.reconstruction.training.segments.segmented_run import SegmentedRun, SegmentFrame
from fourd.recording.capture.frame_rate import DEFAULT_FPS
from fourd.rendering.ops.morton import morton_order
from fourd.scene.container import SceneWriter
from fourd.scene.files.sound import OpusSound
from fourd.scene.scene import (
    BAKED_LAYERS,
    SHADOW_IDENTITY,
    BakedFrame,
    SceneBackground,
    SceneManifest,
    make_frame,
    to_triple,
)
from fourd.scene.styled.normals import add_normals

GetSourceView = Callable[[int, EvaluatedPoints], SourceViews]
"""Function that returns the source view (image and camera) of the camera with the given index. If occlusion is tested,
the view also has a depth map of the given points."""

MAX_BAKED_WEIGHT = 1024.0
"""The blend weights of each point are scaled such that the largest one has this value, because small weights would
otherwise underflow in fp16."""


def bake_run(
    trained: TrainedRun | SegmentedRun,
    out: Path,
    console: Console,
    layers: int = BAKED_LAYERS,
    fps: float | None = None,
    track: Track | None = None,
    sound: OpusSound | None = None,
) -> None:
    """Write the run's newest checkpoint as the scene file ``out``, one frame at a time (4K4D, sec. 3.4).

    Blend weights (fp16) and colours (uint8) of the points are baked for every training view. In frames that belong to
    two segments (ranges of frames with separate models), the scene fades from the first segment to the second.

    Args:
        layers: maximum number of points that are composited per pixel. The number is stored in the scene.
        fps: playback rate, frames per second. If None, the rate at which the run's frames were recorded is used, or 30
            if this rate is not known.
        track: reports the progress of the frames. If None, the console shows it.
        sound: the sound of the scene, or None.

    Raises:
        UserError: if the model's blend weights depend on the viewing camera, or if the file cannot be written.
    """
    run = trained.run
    require_bakeable(run)
    sources = select_baked_views(run)
    first = trained.segment(0) if isinstance(trained, SegmentedRun) else trained
    manifest = replace(make_manifest(first, layers, fps), frame_numbers=run.capture.frame_numbers)
    with SceneWriter(out, manifest) as writer, torch.no_grad():
        if sound is not None:
            writer.add_sound(sound)
        background = bake_background(first, sources)
        if background is not None:
            writer.add_background(add_normals(background, manifest, is_background=True))
        count = run.capture.frame_count
        for frame in (track or Tracker(console).track)(range(count), count, "export"):
            if isinstance(trained, SegmentedRun):
                writer.add_frame(frame, add_normals(_bake_segments(trained.at(frame), sources), manifest))
            else:
                baked = add_normals(bake_frame(trained, frame, sources), manifest)
                writer.add_frame(frame, baked, bake_shadow(trained, frame))


def require_bakeable(run: Run) -> None:
    """Raise UserError if the model's blend weights depend on the viewing camera."""
    if run.config.train.model.continuous:
        raise UserError(
            f"{run.folder}: expected blend weights that do not depend on the viewer, got model.continuous: true; "
            f"train with model.continuous: false"
        )


def select_baked_views(run: Run) -> list[int]:
    """Return the cameras for which colours are baked: the training views, or no cameras if the run stores colours only
    as spherical harmonics."""
    return run.training if run.config.train.model.appearance != "sh" else []


def make_manifest(trained: TrainedRun, layers: int = BAKED_LAYERS, fps: float | None = None) -> SceneManifest:
    """Return the manifest of a run's scene. The writer adds the number of dynamic points of each frame.

    For ``fps``, see :func:`bake_run`.
    """
    rate = fps or trained.run.capture.fps
    run, background = trained.run, trained.renderer.background
    sources = select_baked_views(run)
    others = [index for index in range(len(run.capture.names)) if index not in sources]
    return SceneManifest(
        source_names=tuple(run.capture.names[index] for index in sources),
        source_cameras=tuple(run.capture.cameras[index] for index in sources),
        focus=to_triple(run.focus),
        bounds=(run.config.scene.lower, run.config.scene.upper),
        frame_numbers=run.capture.frame_numbers,
        other_names=tuple(run.capture.names[index] for index in others),
        other_cameras=tuple(run.capture.cameras[index] for index in others),
        fps=rate or DEFAULT_FPS,
        is_fps_known=rate is not None,
        metres_per_unit=trained.run.capture.metres_per_unit,
        layers=layers,
        neighbours=run.config.train.model.neighbours,
        fade_views=run.config.train.model.fade_views,
        sh_range=trained.model.sh_range,
        sh_base=trained.model.sh_base,
        near=run.config.scene.near,
        pixel_filter=run.config.train.pixel_filter,
        kind=run.config.train.scene,
        background=None if background is None else SceneBackground(background.points.xyz.shape[0], shadow=False),
        producer=f"fourd {__version__}",
    )


def bake_frame(trained: TrainedRun, frame: int, sources: list[int], track: Track = untracked) -> BakedFrame:
    """Evaluate one frame's dynamic points. The result has no property that depends on the viewing camera.

    ``sources`` are the camera indices from :func:`select_baked_views`. ``track`` reports the progress over them.
    """
    views = trained.renderer.views
    occlusion = trained.model.config.occlusion

    def get_source_view(index: int, points: EvaluatedPoints) -> SourceViews:
        return with_surface_depth(views.sources([index], frame), points, occlusion, trained.run.config.scene.near)

    points, time = trained.frames.get(frame), trained.run.capture.time(frame)
    return _bake_points(trained.model, points, time, sources, get_source_view, track)


def _bake_segments(parts: Sequence[SegmentFrame], sources: list[int]) -> BakedFrame:
    """Bake a frame from the points of the one or two segments (ranges of frames with separate models) that contain the
    frame."""
    baked = [bake_frame(part.trained, part.frame, sources) for part in parts]
    if len(baked) == 1:
        return baked[0]
    kept = [part.kept(frame.point_count) for part, frame in zip(parts, baked, strict=True)]
    arrays = {
        name: np.concatenate([frame.arrays[name][rows] for frame, rows in zip(baked, kept, strict=True)])
        for name in baked[0].arrays
    }
    order = morton_order(arrays["xyz"])
    return make_frame({name: array[order] for name, array in arrays.items()})


def bake_background(trained: TrainedRun, sources: list[int], track: Track = untracked) -> BakedFrame | None:
    """Evaluate the static background points, with clean plates (images of the background without the subject) as source
    views. ``track`` reports the progress over them. Returns None if the run has no background."""
    background = trained.renderer.background
    if background is None:
        return None
    return _bake_points(
        background.model,
        background.points,
        0.0,
        sources,
        lambda index, points: background.sources([index], points=points),
        track,
    )


def bake_shadow(trained: TrainedRun, frame: int) -> NDArray[np.uint8] | None:
    """Evaluate a frame's shadow factors, which multiply the colours of the M background points. Returns (M,) uint8 in
    units of 1/128, or None if the run has no shadow model."""
    background = trained.renderer.background
    if background is None or background.model.shadow is None:
        return None
    factor = background.model.shadow(background.points.xyz, trained.run.capture.time(frame)).factor
    return (SHADOW_IDENTITY * factor).round().clamp(0, 255).byte().numpy()


def _bake_points(
    model: PointModel,
    points: FramePoints,
    time: float,
    sources: list[int],
    get_source_view: GetSourceView,
    track: Track,
) -> BakedFrame:
    parameters = points.parameters
    evaluated = model.evaluate(
        points.xyz, points.spacing, time, explicit_sh=parameters.get("sh"), rgb=parameters.get("rgb")
    )
    sh = model.harmonics(evaluated, is_training=False)
    weights, rgb = _bake_blending(model, evaluated, sources, get_source_view, track)
    count = evaluated.xyz.shape[0]
    return BakedFrame(
        xyz=evaluated.xyz.numpy(),
        radius=evaluated.radius.numpy().astype(np.float16),
        density=evaluated.density.numpy().astype(np.float16),
        sh=np.zeros((count, 3, 16), np.float16) if sh is None else sh.numpy().astype(np.float16),
        blend_weights=weights.numpy().astype(np.float16),
        rgb=(rgb * 255).round().clamp(0, 255).byte().numpy(),
    )


def _bake_blending(
    model: PointModel, points: EvaluatedPoints, sources: list[int], get_source_view: GetSourceView, track: Track
) -> tuple[Tensor, Tensor]:
    """Compute the points' blend weights (N, V) and their colours (N, V, 3) in [0, 1], one source view at a time.

    The blend weight of a point is 0 in the views in which it is occluded.
    """
    count = points.xyz.shape[0]
    weights = torch.zeros(count, len(sources))
    rgb = torch.zeros(count, len(sources), 3)
    for column, index in enumerate(track(sources, len(sources), "views")):
        view = get_source_view(index, points)
        encoded = model.encode_images(view.images) if view.encoded is None else view.encoded
        samples = sample_sources(points.xyz, view, encoded, OCCLUSION_FALLOFF_SPACINGS * points.spacing)
        logits = model.blend_logits(points, samples, view, None)
        visibility = zero_low_visibility(samples.visibility[0])
        mixed = mix_own_colours(samples.colours, samples.visibility, points.rgb, model.config.own_colour)
        weights[:, column] = torch.exp(logits[0]) * visibility
        rgb[:, column] = mixed[0]
    if sources:
        weights = weights * (MAX_BAKED_WEIGHT / weights.max(dim=1, keepdim=True).values.clamp(min=1e-30))
    return weights, rgb
