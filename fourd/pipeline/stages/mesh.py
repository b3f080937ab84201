"""Meshes: makes one textured mesh for each frame, and computes the scores of the meshes in held-out views."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.json_file import Finite, decode_json
from fourd.base.limits import read_json
from fourd.pipeline.stage import Artefact, Context, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.plates import MATTE_PATTERNS
from fourd.reconstruction.meshes.rendering import render_mesh, silhouette_iou
from fourd.reconstruction.meshes.sequence import mesh_capture
from fourd.reconstruction.meshes.settings import MeshSettings
from fourd.reconstruction.meshes.texturing.texture import TexturedMesh, read_textured_mesh
from fourd.reconstruction.training.cameras.selection import DECODED_MB, DataSelection, open_run_views
from fourd.reconstruction.training.evaluation.metrics import mask_box, psnr
from fourd.reconstruction.training.run import load_run
from fourd.recording.capture import Capture, open_capture

SCORES_NAME = "scores.json"


@dataclass(frozen=True)
class MeshFiles:
    """Inputs and output of meshing.

    Attributes:
        capture: the capture's folder.
        meshes: folder to which the meshes are written.
        run: run folder with adjusted cameras. If None, the cameras of the capture are used.
    """

    capture: Path
    meshes: Path
    run: Path | None = None


@dataclass(frozen=True)
class MeshStageSettings:
    """Selected views and frames, and the settings of the meshes. Held-out views are used only for scores. If ``force``
    is true, meshes that were made with other settings are replaced."""

    selection: DataSelection
    mesh: MeshSettings
    force: bool = False


@dataclass(frozen=True)
class MeshScore:
    """Score of one mesh in one held-out view.

    Attributes:
        camera: name of the camera.
        frame: number of the frame.
        iou: intersection over union of the mesh's silhouette and the matte.
        psnr: PSNR in dB of the rendered mesh against the masked image, both on black, inside the matte's bounding box;
            None if the matte is empty.
    """

    camera: str
    frame: int
    iou: float
    psnr: float | None


def mesh_stage(files: MeshFiles, settings: MeshStageSettings) -> Stage[MeshFiles, MeshStageSettings]:
    """Create the stage that makes the meshes of a capture."""
    return Stage(
        "mesh",
        run_mesh,
        files,
        settings,
        inputs=(Artefact(files.capture, INPUT_PATTERNS + MATTE_PATTERNS),),
        outputs=(files.meshes,),
    )


def run_mesh(files: MeshFiles, settings: MeshStageSettings, context: Context) -> None:
    """Make the mesh of every frame. Meshes that an earlier call made with the same settings are kept."""
    whole, training, test = _open_views(files, settings.selection)
    with whole, training:
        training = training.with_mattes(context.log)
        unmasked = [whole.names[index] for index in test if index not in whole.masked]
        if unmasked:
            context.log(f"{whole.path}: not scored, because these views have no mattes: {', '.join(unmasked)}")
        test = [index for index in test if index in whole.masked]
        paths = mesh_capture(training, files.meshes, settings.mesh, context.track, force=settings.force)
        if not test or settings.mesh.format != "glb":
            return
        scores = [
            score
            for frame in context.track(range(len(paths)), len(paths), "scores")
            for score in score_mesh(read_textured_mesh(paths[frame]), whole, test, frame)
        ]
    content = {"mean": asdict(mean_score(scores)), "pictures": [asdict(score) for score in scores]}
    write_text_atomically(files.meshes / SCORES_NAME, json.dumps(content, indent=1) + "\n")


def score_mesh(mesh: TexturedMesh, capture: Capture, views: Sequence[int], frame: int) -> list[MeshScore]:
    """Compare the mesh of a frame with the images of some cameras. ``views`` are indices into ``capture.cameras``."""
    number, scores = capture.frame_numbers[frame], []
    for view in views:
        matte = capture.mask(view, frame)
        rendered = render_mesh(mesh, capture.cameras[view])
        truth = (capture.image(view, frame) * (matte[..., None] / 255**2)).astype(np.float32)
        box = mask_box(matte)
        part = None if box is None else np.s_[box[0] : box[1], box[2] : box[3]]
        decibels = None if part is None else float(psnr(rendered.rgb[part], truth[part]))
        scores.append(MeshScore(capture.names[view], number, silhouette_iou(rendered.alpha, matte), decibels))
    return scores


@dataclass(frozen=True)
class MeanScore:
    """Mean scores: intersection over union, and PSNR in dB. The PSNR is None if all mattes are empty."""

    iou: Finite
    psnr: Finite | None


def mean_score(scores: Sequence[MeshScore]) -> MeanScore:
    """Return the mean of the scores of one or more images."""
    decibels = [score.psnr for score in scores if score.psnr is not None]
    return MeanScore(float(np.mean([score.iou for score in scores])), float(np.mean(decibels)) if decibels else None)


def read_scores(folder: Path) -> MeanScore:
    """Read the mean scores that :func:`run_mesh` wrote into the folder of the meshes.

    Raises UserError if the file is missing or does not contain the scores of meshes.
    """
    path = folder / SCORES_NAME
    try:
        return decode_json(read_json(path)["mean"], MeanScore)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: expected the scores of meshes, got other content; delete the file") from error


def _open_views(files: MeshFiles, selection: DataSelection) -> tuple[Capture, Capture, list[int]]:
    """Open the capture. Returns the whole capture, the capture without held-out views, and the indices of the held-out
    cameras in the whole capture."""
    if selection.views is not None and len(selection.views) < 2:
        raise UserError(f"--views: expected at least 2 views, got {len(selection.views)}; choose more views")
    views = open_run_views(files.capture, selection)
    capture = views.capture if files.run is None else _with_run_cameras(views.capture, files.run)
    cameras = [capture.cameras[index] for index in views.training]
    training = open_capture(
        files.capture,
        views=list(views.training_names),
        frames=selection.frames,
        scale=selection.image_scale,
        cache_mb=DECODED_MB,
    )
    return capture, training.with_cameras(cameras), views.test


def _with_run_cameras(capture: Capture, run: Path) -> Capture:
    """Return the capture with the newest cameras of a run, which training may have refined."""
    with load_run(run).run as opened:
        refined = opened.capture
    known = dict(zip(refined.names, refined.cameras, strict=True))
    for name in capture.names:
        if name not in known:
            raise UserError(f"{run}: expected the camera '{name}', got none; choose --views that the run uses")
    pairs = zip(capture.names, capture.cameras, strict=True)
    return capture.with_cameras([known[name].resize(camera.width, camera.height) for name, camera in pairs])
