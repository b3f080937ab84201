"""Reads baked frames from `.4dv` files and other scenes, or bakes them from a run's newest checkpoint."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from fourd.base.errors import UserError, command_line
from fourd.base.progress import Item, Track
from fourd.base.storage import Location, StorageUrl
from fourd.reconstruction.training.run_layout import newest_checkpoint
from fourd.scene import BakedFrame, SceneManifest, SceneReader, combine_frames
from fourd.scene.meshes.source import is_mesh
from fourd.scene.splats.reader import is_splats, open_reader
from fourd.viewer.playback.prefetch import BakedFrameSource

if TYPE_CHECKING:
    from fourd.reconstruction.training.run import TrainedRun

Report = Callable[[str], None]
"""Called with what is being done while a scene is opened."""
_NICENESS = 10


def unreported(work: str) -> None:
    """Report nothing."""


class RunSource:
    """Computes (bakes) the frames of a training run from its newest checkpoint. This class needs torch and is not
    thread-safe.

    Attributes:
        share: share of the frame that is being computed, from 0 to 1, by the number of views whose colours are done. It
            is 0 if the run has no such views. Another thread may read it.

    Raises UserError when the folder is not a run, has no readable checkpoint, or cannot be baked.
    """

    def __init__(self, folder: Path, report: Report = unreported) -> None:
        report("loading torch")
        from fourd.scene.bake import make_manifest, require_bakeable

        _lower_priority()
        self._folder = folder
        self._trained: TrainedRun | None = None
        self._background: BakedFrame | None = None
        self.share = 0.0
        self._background_step = -1  # training step of the checkpoint from which the background is baked
        report("reading the checkpoint")
        trained = self._load_newest()
        require_bakeable(trained.run)
        self.manifest: SceneManifest = make_manifest(trained)

    @property
    def checkpoint(self) -> str:
        """File name of the newest checkpoint on disk, or an empty string when there is no checkpoint."""
        return newest_checkpoint(self._folder)

    def read(self, index: int) -> BakedFrame:
        """Bake a frame of the newest checkpoint. Raises UserError if the frame has an invalid value, such as NaN."""
        try:
            return self._bake(index)
        except FileNotFoundError:  # training replaced the checkpoint during loading
            return self._bake(index)

    def read_sound(self) -> None:
        """Return None, because the sound is chosen when a scene is written."""

    def close(self) -> None:
        """Remove the loaded model from memory."""
        self._trained = None

    def _bake(self, index: int) -> BakedFrame:
        import torch

        from fourd.scene.bake import bake_background, bake_frame, select_baked_views

        trained = self._load_newest()
        views = select_baked_views(trained.run)
        with torch.no_grad():
            needs_background = trained.step != self._background_step and trained.renderer.background is not None
            track = self._tracker((2 if needs_background else 1) * len(views))
            frame = bake_frame(trained, index, views, track)
            if needs_background:
                self._background = bake_background(trained, views, track)
                self._background_step = trained.step
        if self._background is not None:
            frame = combine_frames(frame, self._background)
        invalid = frame.find_invalid_array()
        if invalid is not None:
            raise UserError(
                f"{self._folder}: expected valid values of {invalid} in frame {index} at step {trained.step}, "
                "got NaN, infinity or a value out of range; training has failed: lower the learning rates"
            )
        return frame

    def _tracker(self, total: int) -> Track:
        """Return a function that counts ``total`` views in :attr:`share`."""
        self.share, done = 0.0, 0

        def track(items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
            nonlocal done
            for item in items:
                yield item
                done += 1
                self.share = done / total

        return track

    def _load_newest(self) -> TrainedRun:
        from fourd.reconstruction.training.run import load_run

        if self._trained is None or self.checkpoint != f"{self._trained.step:08d}.safetensors":
            self._trained = load_run(self._folder)
        return self._trained


def _open_run(folder: Path, report: Report) -> RunSource:
    try:
        return RunSource(folder, report)
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package == "fourd":
            raise
        raise UserError(
            f"{folder}: expected the training packages, which runs need, got no {package}; pip install 'fourd[train]'"
        ) from error


def _lower_priority() -> None:
    """Lower the priority of this process, so that viewing a run does not slow its training."""
    if hasattr(os, "nice") and os.nice(0) < _NICENESS:
        os.nice(_NICENESS - os.nice(0))


def open_frame_source(path: Location, report: Report = unreported) -> BakedFrameSource:
    """Open a `.4dv` file or its URL, a run's folder, a file of Gaussian splats or a folder of such files.

    ``report`` is called with what is done to open a run, which takes seconds.

    Raises UserError, which names the file and the fix, if the scene or run cannot be opened.
    """
    source: BakedFrameSource = SceneReader(path) if isinstance(path, StorageUrl) else _open_local(path, report)
    manifest = source.manifest
    if manifest.frame_count == 0:
        source.close()
        raise UserError(f"{path}: expected at least one frame, got a scene without frames; export the scene again")
    if manifest.points and not any(manifest.points) and manifest.background_nbytes == 0:
        source.close()
        raise UserError(f"{path}: expected points in at least one frame, got none; export the scene again")
    return source


def _open_local(path: Path, report: Report) -> BakedFrameSource:
    if not path.exists():
        raise UserError(f"{path}: expected a .4dv file or a run's folder, got nothing there; check the path")
    if is_mesh(path) and not is_splats(path):
        got = "meshes, which are not points"
        raise UserError(
            f"{path}: expected a scene or a run, got {got}; draw them with "
            f"{command_line('fourd', 'render', path, '--path', 'orbit')}"
        )
    is_run = path.is_dir() and not is_splats(path)
    return _open_run(path, report) if is_run else open_reader(path)
