"""The run folder: what was trained, on what, and where its checkpoints are.

``config.yaml`` (written once), ``hull/`` (carved points), ``checkpoints/STEP.safetensors`` with
``checkpoints/STEP.points/``, ``metrics.jsonl``, TensorBoard events and ``validation/``.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from scipy.spatial import cKDTree

from fourd.background.contraction import Contraction, contraction_around
from fourd.capture import Capture, open_capture
from fourd.capture.layout import select_views
from fourd.carving import Bounds, carve_capture
from fourd.configs import load_overlay, save_config
from fourd.errors import UserError
from fourd.model import PointModel
from fourd.model.shadow import ShadowField
from fourd.morton import morton_order
from fourd.ply import read_ply, write_ply
from fourd.progress import Log, Track, untracked
from fourd.training.background import StaticBackground, create_background
from fourd.training.background_seed import BACKGROUND, POINTS, run_plates, seed_background
from fourd.training.cameras.calibration import CALIBRATION, adjust_run, begun_with
from fourd.training.cameras.refinement import Refinement
from fourd.training.cameras.rig import Rig
from fourd.training.checkpoints import latest_checkpoint, load_checkpoint, restore
from fourd.training.config import TrainConfig
from fourd.training.evaluation.render import Renderer
from fourd.training.points.frame_points import FramePoints
from fourd.training.points.frame_store import FrameStore
from fourd.training.scenes.build import build_scene
from fourd.training.views import ViewStore

CONFIG_NAME = "config.yaml"
STAGES = ("hull", BACKGROUND, CALIBRATION)
"""Folders of a run that are there before it is one."""
DECODED_MB = 32
"""Of whole pictures: the crops that training uses have a cache of their own."""


@dataclass(frozen=True)
class SceneConfig:
    """What was measured on the capture before training; all in world units."""

    lower: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Lower corner of the bounds."""
    upper: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Upper corner of the bounds."""
    spacing: float = 0.01
    """Mean distance between neighbouring points."""
    frame_count: int = 1
    """Frames of the whole capture."""
    reach: float = 1.0
    """Distance from the middle of the bounds to the farthest camera: a background keeps its shape so far."""


@dataclass(frozen=True)
class RunConfig:
    """The run's config.yaml."""

    capture: Path = Path()
    """The capture's folder, absolute."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    train: TrainConfig = field(default_factory=TrainConfig)


@dataclass(frozen=True)
class Run:
    """A run folder that was opened: the capture it belongs to and who is held out.

    Attributes:
        folder: the run's folder.
        config: its config.yaml.
        capture: the selected views and frames of the capture, training and test.
        training, test: indices into ``capture.cameras``.
    """

    folder: Path
    config: RunConfig
    capture: Capture
    training: list[int]
    test: list[int]

    @property
    def focus(self) -> NDArray[np.float64]:
        """(3,) centre of the bounds: view angles are measured from here."""
        return (np.asarray(self.config.scene.lower) + np.asarray(self.config.scene.upper)) / 2

    @property
    def checkpoints(self) -> Path:
        return self.folder / "checkpoints"

    def new_model(self) -> PointModel:
        """An untrained model, the same for the same config."""
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
        """Corrections of the capture's cameras, none as yet; None where the config asks for none."""
        refine = self.config.train.refine
        if not (refine.cameras or refine.colours):
            return None
        return Refinement(refine, self.capture.cameras, self.training, self.focus)

    def contraction(self) -> Contraction:
        """The space that a background lies in."""
        x, y, z = (float(value) for value in self.focus)
        return Contraction((x, y, z), self.config.scene.reach)

    def background(self, saved: Path | None) -> StaticBackground | None:
        """A full scene's background, from the points ``saved`` by a checkpoint or else as seeded; None of an object."""
        if self.config.train.scene != "full":
            return None
        seeded = read_ply(self.folder / BACKGROUND / POINTS)
        plates = dict(zip(self.training, run_plates(self.capture, self.training, self.folder), strict=True))
        torch.manual_seed(self.config.train.seed + 1)
        fresh = create_background(seeded, plates, self.config.train, self.contraction())
        if self.config.train.background.shadow:
            scene = self.config.scene
            fresh.model.shadow = ShadowField(np.asarray(scene.lower), np.asarray(scene.upper), scene.frame_count)
        if saved is not None:
            fresh.points = FramePoints.from_tensors(load_file(saved / f"{BACKGROUND}.safetensors"))
        return fresh

    def view_store(self) -> ViewStore:
        """Training pictures by the config's crop and memory bound."""
        train = self.config.train
        return ViewStore(self.capture, train.crop == "mask", train.memory_mb)

    def frame_store(self, saved: Path | None, scratch_name: str) -> FrameStore:
        """Points of every frame, from ``saved`` or else as carved."""
        scratch = self.folder / "scratch" / scratch_name
        return FrameStore(scratch, self.capture.frame_count, self.carved, self.config.train.memory_mb // 2, saved)

    def carved(self, frame: int) -> FramePoints:
        """Points of a frame as carved, at most as many as the config asks for; neighbours lie side by side."""
        train = self.config.train
        number = self.capture.frame_numbers[frame]
        xyz = read_ply(self.folder / "hull" / f"{number:06d}.ply").xyz[: train.points]
        spacing = torch.full((len(xyz),), self.config.scene.spacing)
        explicit = train.model.sh == "explicit" and train.model.appearance != "ibr"
        placed = torch.from_numpy(xyz[morton_order(xyz)])
        return FramePoints.fresh(placed, spacing, train.model.radius_start, explicit_sh=explicit)


@dataclass(frozen=True)
class TrainedRun:
    """A run with its newest good checkpoint loaded."""

    run: Run
    step: int
    model: PointModel
    frames: FrameStore
    renderer: Renderer


def carve_run(
    capture_path: Path, folder: Path, train: TrainConfig, track: Track = untracked, workers: int = 1
) -> Bounds:
    """Carve the training views of the selection into ``folder/hull``; goes on where an earlier call stopped.

    Held-out views are not carved from: they must not shape what they judge.
    """
    capture, training, _ = _open_views(capture_path, train, folder)
    _require_masks(capture)
    folder.mkdir(parents=True, exist_ok=True)
    seeing = open_capture(
        capture_path,
        views=[capture.names[index] for index in training],
        frames=train.frames,
        scale=train.image_scale,
        cache_mb=DECODED_MB,
    ).with_cameras([capture.cameras[index] for index in training])
    return carve_capture(seeing, folder / "hull", points=train.points, track=track, workers=workers)


def adjust_run_cameras(capture_path: Path, folder: Path, train: TrainConfig, track: Track, log: Log) -> None:
    """Where the config refines cameras, write those that the run begins with into ``folder/calibration/start``."""
    if train.refine.cameras:
        capture, training, _ = _open_views(capture_path, train)
        adjust_run(capture, training, folder, train.refine, track, log)


def seed_run(capture_path: Path, folder: Path, train: TrainConfig, workers: int, track: Track, log: Log) -> None:
    """Find the points of a full scene's background in ``folder/background``; goes on where an earlier call stopped."""
    capture, training, _ = _open_views(capture_path, train, folder)
    seed_background(capture, training, folder, train, workers, track, log)


def adopt_points(source: Path, capture_path: Path, folder: Path, train: TrainConfig) -> Bounds:
    """Take the user's own FRAME.ply of each selected frame from ``source`` into ``folder/hull``.

    Where a file has more points than the config asks for, an even draw of them is kept. The bounds
    are those of all points, with a margin of 5% of the longest side.
    """
    capture, _, _ = _open_views(capture_path, train)
    rng = np.random.default_rng(train.seed)
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for number in capture.frame_numbers:
        xyz, rgb = read_ply(source / f"{number:06d}.ply")
        if len(xyz) == 0:
            raise UserError(f"{source / f'{number:06d}.ply'}: expected points, got none; leave the frame out")
        kept = rng.permutation(len(xyz))[: train.points]
        write_ply(folder / "hull" / f"{number:06d}.ply", xyz[kept], rgb[kept])
        lower, upper = np.minimum(lower, xyz.min(axis=0)), np.maximum(upper, xyz.max(axis=0))
    return Bounds(lower, upper).padded(0.05)


def create_run(
    capture_path: Path,
    folder: Path,
    train: TrainConfig,
    points_from: Path | None = None,
    track: Track = untracked,
    workers: int = 1,
    log: Log = lambda line: None,
) -> Run:
    """Make a run folder: check the selection, carve the training views, measure bounds and spacing.

    With ``points_from``, the points are that folder's FRAME.ply files and nothing is carved; else ``workers``
    processes carve. A full scene's background is seeded too. A folder that holds these alone is taken over, as an
    interrupted call leaves one. ``log`` is told what was found. Raises
    UserError when ``folder`` exists and is not a run, or is a run already.
    """
    if (folder / CONFIG_NAME).exists():
        raise UserError(f"{folder}: expected a new folder, got a run; add --resume to go on with it, or name another")
    if folder.exists() and (not folder.is_dir() or any(entry.name not in STAGES for entry in folder.iterdir())):
        raise UserError(f"{folder}: expected a new or empty folder, got one that is not a run; name another with --out")
    adjust_run_cameras(capture_path, folder, train, track, log)
    if points_from is None:
        bounds = carve_run(capture_path, folder, train, track, workers)
    else:
        bounds = adopt_points(points_from, capture_path, folder, train)
    if train.scene == "full":
        seed_run(capture_path, folder, train, workers, track, log)
    capture, _, _ = _open_views(capture_path, train, folder)
    first = read_ply(folder / "hull" / f"{capture.frame_numbers[0]:06d}.ply").xyz
    reach = contraction_around(capture.cameras, bounds.centre).radius
    scene = SceneConfig(
        lower=_triple(bounds.lower),
        upper=_triple(bounds.upper),
        spacing=mean_spacing(first[: train.points]),
        frame_count=max(capture.total_frames, 1),
        reach=reach,
    )
    save_config(RunConfig(capture_path.resolve(), scene, train), folder / CONFIG_NAME)
    return open_run(folder)


def open_run(folder: Path) -> Run:
    """Open a run folder and its capture. Raises UserError when either is not what it should be."""
    path = folder / CONFIG_NAME
    if not path.is_file():
        raise UserError(f"{folder}: expected a run (a folder with {CONFIG_NAME}), got none; make one with fourd train")
    config = load_overlay(RunConfig(), path)
    capture, training, test = _open_views(config.capture, config.train, folder)
    return Run(folder, config, capture, training, test)


def load_run(folder: Path) -> TrainedRun:
    """Open a run and load its newest good checkpoint, for evaluation, rendering and export."""
    run = open_run(folder)
    found, note = latest_checkpoint(run.checkpoints)
    if found is None:
        raise UserError(
            f"{folder}: expected a trained run, got no good checkpoint {note}; go on with fourd train --resume"
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
    scene = build_scene(run.config.train, model, run.view_store(), background)
    for prefix, each in scene.models.items():
        restore(each, tensors, f"{prefix}.", found)
        each.requires_grad_(False)
    scene.set_rig(rig)
    frames = run.frame_store(points_folder(found), "reader")
    return TrainedRun(run, step, model, frames, Renderer(scene, run.training, run.focus))


def points_folder(checkpoint: Path) -> Path:
    """Where the points of a checkpoint file lie."""
    return checkpoint.with_suffix(".points")


def drop_stale_points(checkpoints: Path) -> None:
    """Remove points whose checkpoint file is gone or was never finished."""
    for folder in checkpoints.glob("*.points"):
        if not folder.with_suffix(".safetensors").exists():
            shutil.rmtree(folder)


def mean_spacing(xyz: NDArray[np.float32]) -> float:
    """Mean distance from a point to its fourth-nearest neighbour over two: the spacing of an even sheet.

    The nearest neighbour alone would depend on how even the sampling is.
    """
    if xyz.shape[0] < 6:
        return 0.01
    distances, _ = cKDTree(xyz).query(xyz[:4096], k=5)
    return float(distances[:, 1:].mean() / 1.2)


def _open_views(path: Path, train: TrainConfig, run: Path | None = None) -> tuple[Capture, list[int], list[int]]:
    """The capture's selection, with the cameras that the run in folder ``run`` begins with, and who is held out."""
    views = list(train.views) if train.views is not None else None
    capture = open_capture(path, views=views, frames=train.frames, scale=train.image_scale, cache_mb=DECODED_MB)
    held_out = select_views(train.test_views, capture.names, "--test-views") if train.test_views else []
    test = [capture.names.index(name) for name in held_out]
    training = [index for index in range(len(capture.names)) if index not in test]
    if len(training) < 2:
        raise UserError(
            f"{path}: expected at least 2 training views, got {len(training)}; hold out fewer with --test-views"
        )
    if train.refine.cameras and run is not None:
        capture = begun_with(capture, run)
    return capture, training, test


def _require_masks(capture: Capture) -> None:
    if not capture.has_masks:
        raise UserError(
            f"{capture.path}: expected masks/CAM/FRAME.png for an object scene, got none; "
            f"make them: fourd matte {capture.path}"
        )


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
