"""A run folder: its config, its capture, and its trained points and models.

``hull/``, ``background/`` and ``calibration/`` are written before training. ``config.yaml`` is written when training
starts. ``checkpoints/STEP.safetensors``, ``checkpoints/STEP.points/``, ``metrics.jsonl``, TensorBoard events and
``validation/`` are written while training.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.configs import load_overlay
from fourd.base.errors import UserError, command_line
from fourd.base.files import remove_unfinished
from fourd.base.formats.ply import ColouredPoints, read_ply
from fourd.base.progress import Log
from fourd.reconstruction.background.contraction import Contraction
from fourd.reconstruction.background.plates import PlateView, read_plates
from fourd.reconstruction.model import PointModel
from fourd.reconstruction.model.shadow import ShadowField
from fourd.reconstruction.training.background import StaticBackground, create_background
from fourd.reconstruction.training.cameras.measured_colours import read_measured_colours
from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views
from fourd.reconstruction.training.checkpoints import latest_checkpoint, load_checkpoint, restore
from fourd.reconstruction.training.config import HeldOutConfig, TrainConfig
from fourd.reconstruction.training.evaluation.render import ModelRenderer, RenderedView
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.frame_store import FrameStore, load_points
from fourd.reconstruction.training.points.near_plane import is_before_near
from fourd.reconstruction.training.points.scratch import Scratch
from fourd.reconstruction.training.run_layout import (
    BACKGROUND,
    CHECKPOINTS,
    CONFIG_NAME,
    HULL,
    PLATES,
    POINTS,
    PREPARATION,
    SCRATCH,
    SEGMENTS,
    VALIDATION,
    points_folder,
)
from fourd.reconstruction.training.scenes.build import build_scene
from fourd.reconstruction.training.views import ViewStore
from fourd.recording.capture import Capture
from fourd.rendering.ops.gpu import CPU
from fourd.rendering.ops.morton import morton_order


@dataclass(frozen=True)
class SceneConfig:
    """Quantities that are measured from the capture before training. Lengths are in world units."""

    lower: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Lower corner of the bounds, an axis-aligned box around the subject."""
    upper: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Upper corner of the bounds."""
    spacing: float = 0.01
    """Mean distance between neighbouring points."""
    first_frame: int = 0
    """Frame at time 0, as an index into the capture's frames: the first frame of a segment, or 0 for a run without
    segments."""
    frame_count: int = 1
    """Number of frames from time 0 to time 1: the frames of a segment, or all frames of the capture for a run without
    segments."""
    reach: float = 1.0
    """Distance from the centre of the bounds to the farthest camera. Up to this distance from the centre, the
    contraction of space for the background's K-Planes causes no distortion."""
    near: float = 0.01
    """Depth of the near plane (see :mod:`fourd.reconstruction.training.points.near_plane`)."""
    static_near: float | None = None
    """Depth before which no camera of the capture shows a point of the background, or null if it is ``near``."""


@dataclass(frozen=True)
class RunConfig:
    """Content of the run's config.yaml."""

    capture: Path = Path()
    """Absolute path of the capture's folder."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    train: TrainConfig = field(default_factory=TrainConfig)


@dataclass(frozen=True)
class Run:
    """An open run folder.

    Attributes:
        folder: the run's folder.
        config: content of the run's config.yaml.
        capture: the capture with the selected training and test views and the selected frames.
        training: indices of the training cameras in ``capture.cameras``.
        test: indices of the held-out cameras in ``capture.cameras``.
    """

    folder: Path
    config: RunConfig
    capture: Capture
    training: list[int]
    test: list[int]

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *exception: object) -> None:
        self.capture.close()

    @property
    def focus(self) -> NDArray[np.float64]:
        """(3,) centre of the bounds, in world units. Angles between cameras are measured at this point. The cameras
        nearest to a viewing camera are those with the smallest angles to it."""
        return (np.asarray(self.config.scene.lower) + np.asarray(self.config.scene.upper)) / 2

    @property
    def has_segments(self) -> bool:
        """True if the run is divided into segments. In this case, each segment's folder contains a model, and the run's
        own folder contains none."""
        return self.config.train.segments.frames is not None

    @property
    def checkpoints(self) -> Path:
        return self.folder / CHECKPOINTS

    def new_model(self) -> PointModel:
        """Create an untrained model. The same config always gives the same model."""
        torch.manual_seed(self.config.train.seed)
        scene = self.config.scene
        return PointModel(
            self.config.train.model,
            np.asarray(scene.lower),
            np.asarray(scene.upper),
            scene.spacing,
            scene.frame_count,
        )

    def new_refinement(self) -> Refinement | None:
        """Create untrained corrections of the training cameras, or return None if the config enables no correction."""
        refine = self.config.train.refine
        if not (refine.cameras or refine.colours):
            return None
        measured = read_measured_colours(self.folder)
        colours = None if measured is None else measured.stacked(self.capture.names)
        return Refinement(refine, self.capture.cameras, self.training, self.focus, colours)

    def contraction(self) -> Contraction:
        """Create the contraction that maps unbounded space into the volume of the background's K-Planes."""
        x, y, z = (float(value) for value in self.focus)
        return Contraction((x, y, z), self.config.scene.reach)

    def background(self, saved: Path | None) -> StaticBackground | None:
        """Create the background of a full scene, or return None for an object scene.

        The background's points are read from the checkpoint folder ``saved``. If ``saved`` is None, initial points are
        used.
        """
        if self.config.train.scene != "full":
            return None
        scene, initial = self.config.scene, read_ply(self.folder / BACKGROUND / POINTS)
        static_near = scene.static_near or scene.near
        kept = ~is_before_near(initial.xyz, self.capture.cameras, static_near)
        initial = ColouredPoints(initial.xyz[kept], initial.rgb[kept])
        plates = dict(zip(self.training, read_run_plates(self.capture, self.training, self.folder), strict=True))
        torch.manual_seed(self.config.train.seed + 1)
        background = create_background(initial, plates, self.config.train, self.contraction(), scene.near)
        background.cameras, background.static_near = tuple(self.capture.cameras), static_near
        if self.config.train.background.shadow:
            background.model.shadow = ShadowField(np.asarray(scene.lower), np.asarray(scene.upper), scene.frame_count)
        if saved is not None:
            background.points = FramePoints.from_tensors(load_points(saved / f"{BACKGROUND}.safetensors"))
        return background

    def view_store(self, device: torch.device = CPU) -> ViewStore:
        """Open the store of images for training on ``device``.

        The store caches decoded images in CPU memory. Training on a GPU needs a large cache, because decoding an image
        takes longer than a step on a GPU. For such training, the size of the cache is therefore an eighth of the free
        GPU memory, but at least the size in the config. This fits because CPU memory is rarely smaller than GPU memory.
        """
        train = self.config.train
        cache_mb = train.memory_mb if device.type != "cuda" else max(train.memory_mb, _free_gpu_mb(device) // 8)
        return ViewStore(self.capture, train.crop == "mask", cache_mb, device)

    def frame_store(self, saved: Path | None, device: torch.device = CPU) -> FrameStore:
        """Open the store of all frames' points, which returns points on ``device``.

        The points are read from the checkpoint folder ``saved``. If ``saved`` is None, initial points are used.
        """
        scratch = Scratch(self.folder / SCRATCH)
        budget_mb = self.config.train.memory_mb // 2 if device.type != "cuda" else _free_gpu_mb(device) // 2
        return FrameStore(scratch, self.capture.frame_count, self.initial_points, budget_mb, saved, device)

    def initial_points(self, frame: int) -> FramePoints:
        """Read at most ``config.train.points`` initial points of a frame, in Morton order."""
        train = self.config.train
        number = self.capture.frame_numbers[frame]
        cloud = read_ply(self.folder / HULL / f"{number:06d}.ply")
        xyz, rgb = cloud.xyz[: train.points], cloud.rgb[: train.points]
        order = morton_order(xyz)
        spacing = torch.full((len(xyz),), self.config.scene.spacing)
        has_own_colours = train.model.own_colour > 0 and train.model.appearance != "sh"
        return FramePoints.initial(
            torch.from_numpy(xyz[order]),
            spacing,
            train.model.radius_start,
            explicit_sh=train.model.sh == "explicit" and train.model.appearance != "ibr",
            rgb=torch.from_numpy(rgb[order]).float() / 255 if has_own_colours else None,
        )


@dataclass(frozen=True)
class TrainedRun:
    """A run with the models and points of its newest intact checkpoint."""

    run: Run
    step: int
    model: PointModel
    frames: FrameStore
    renderer: ModelRenderer

    @property
    def rig(self) -> Rig:
        """The cameras of the capture, with the corrections of the run."""
        return self.renderer.views.rig

    def render(self, frame: int, camera: Camera, layers: int, exclude: int | None = None) -> RenderedView:
        """Render a frame. The arguments have the same meaning as in :meth:`ModelRenderer.render`."""
        return self.renderer.render(self.frames.get(frame), frame, camera, layers, exclude)

    def close(self) -> None:
        """Close the capture, and remove the scratch folder."""
        self.frames.close()
        self.run.capture.close()


def load_run_config(path: Path) -> RunConfig:
    """Read a run's config.yaml. A run of an older version, whose file does not have the key ``held_out``, was trained
    on all its cameras from the start, so it holds out none."""
    return load_overlay(RunConfig(train=TrainConfig(held_out=HeldOutConfig(on=False))), path)


def open_run(folder: Path) -> Run:
    """Open a run folder and its capture.

    Raises UserError if the run or the capture is missing or invalid.
    """
    path = folder / CONFIG_NAME
    if not path.is_file():
        raise UserError(f"{folder}: expected a run (a folder with {CONFIG_NAME}), got none; run fourd train")
    config = load_run_config(path)
    adjusted = folder if config.train.refine.cameras else None
    views = open_run_views(config.capture, DataSelection.of(config.train), adjusted)
    scene = config.scene
    capture = views.capture.with_time_span(range(scene.first_frame, scene.first_frame + scene.frame_count))
    return Run(folder, config, capture, views.training, views.test)


def load_run(folder: Path) -> TrainedRun:
    """Open a run and load its newest intact checkpoint, for evaluation, rendering or export."""
    run = open_run(folder)
    if run.has_segments:
        export = command_line("fourd", "export", folder, "-o", "scene.4dv")
        raise UserError(
            f"{folder}: expected a run with one model, got a run with segments; name one segment, such as "
            f"{folder / SEGMENTS / '000'}, or the scene of all segments: {export}"
        )
    return load_models(run)


def load_models(run: Run) -> TrainedRun:
    """Load the newest intact checkpoint of a run that is not divided into segments (see :func:`open_run`)."""
    found, note = latest_checkpoint(run.checkpoints)
    if found is None:
        reason = f" ({note})" if note else ""
        raise UserError(
            f"{run.folder}: expected a trained run, got no intact checkpoint{reason}; resume with fourd train --resume"
        )
    step, tensors, _ = load_checkpoint(found)
    model = run.new_model()
    rig = Rig(run.capture.cameras)
    refinement = run.new_refinement()
    if refinement is not None:
        restore(refinement, tensors, "refinement.", found)
        rig = refinement.rig()
        run = replace(run, capture=run.capture.with_cameras(rig.cameras))
    background = run.background(points_folder(found))
    scene = build_scene(run.config.train, model, run.view_store(), background, run.config.scene.near)
    for prefix, each in scene.models.items():
        restore(each, tensors, f"{prefix}.", found)
        each.requires_grad_(False)
    scene.set_rig(rig)
    frames = run.frame_store(points_folder(found))
    renderer = ModelRenderer(scene, run.training, run.focus, run.config.train.pixel_filter)
    return TrainedRun(run, step, model, frames, renderer)


def _free_gpu_mb(device: torch.device) -> int:
    return torch.cuda.mem_get_info(device)[0] // 2**20


def read_run_plates(
    capture: Capture, training: Sequence[int], folder: Path, log: Log = lambda line: None
) -> tuple[PlateView, ...]:
    """Read the clean plates of the training views. Plates in the run folder ``folder`` replace those of the capture."""
    made = folder / BACKGROUND / PLATES
    return read_plates(capture, training, log, made=made if made.exists() else None)


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files that remain in a run's folder after a process was killed. The caller must hold the
    lock on the run.

    Scratch folders are not removed, because running processes may use them; see :class:`Scratch`.
    """
    remove_unfinished(folder)
    for name in (*PREPARATION, CHECKPOINTS, VALIDATION):
        remove_unfinished(folder / name, deep=True)


def drop_stale_points(checkpoints: Path) -> None:
    """Remove the points folders of checkpoints whose ``.safetensors`` file is missing, because it was deleted or was
    never completely written."""
    for folder in checkpoints.glob("*.points"):
        if not folder.with_suffix(".safetensors").exists():
            shutil.rmtree(folder)
