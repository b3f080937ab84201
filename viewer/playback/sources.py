"""What can be opened: a `.4dv`, or a run, which is baked frame by frame while it trains."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from fourd.baking import BakedFrame, SceneManifest, SceneReader, combine_frames
from fourd.errors import UserError
from fourd.viewer.playback.prefetch import BakedFrameSource

if TYPE_CHECKING:
    from fourd.training.run import TrainedRun

_NICE = 10


class RunSource:
    """The newest checkpoint of a run; torch is loaded for it. Read by one thread at a time.

    Raises UserError when the folder is no run, has no good checkpoint, or cannot be baked.
    """

    def __init__(self, folder: Path) -> None:
        from fourd.baking.bake import make_manifest, require_bakeable

        _yield_to_training()
        self._folder = folder
        self._trained: TrainedRun | None = None
        self._background: BakedFrame | None = None
        self._trained_step = -1  # of the checkpoint that the background is of
        trained = self._newest()
        require_bakeable(trained.run)
        self.manifest: SceneManifest = make_manifest(trained)

    @property
    def checkpoint(self) -> str:
        """Name of the newest checkpoint file, which need not be read yet; empty while there is none."""
        names = [path.name for path in (self._folder / "checkpoints").glob("*.safetensors") if path.stem.isdecimal()]
        return max(names, default="")

    def read(self, index: int) -> BakedFrame:
        """Bake a frame of the newest checkpoint."""
        try:
            return self._baked(index)
        except FileNotFoundError:  # training has dropped that checkpoint meanwhile: there is a newer one
            return self._baked(index)

    def close(self) -> None:
        self._trained = None

    def _baked(self, index: int) -> BakedFrame:
        import torch

        from fourd.baking.bake import bake_background, bake_frame, select_baked_views

        trained, last = self._newest(), self._trained_step
        sources = select_baked_views(trained.run)
        with torch.no_grad():
            frame = bake_frame(trained, index, sources)
            if trained.step != last:
                self._background = bake_background(trained, sources)
                self._trained_step = trained.step
        if self._background is not None:
            frame = combine_frames(frame, self._background)
        bad = frame.find_invalid_array()
        if bad is not None:
            raise UserError(
                f"{self._folder}: expected finite numbers, got others in {bad} of frame {index} "
                f"at step {trained.step}; training has failed: lower the learning rates"
            )
        return frame

    def _newest(self) -> TrainedRun:
        from fourd.training.run import load_run

        if self._trained is None or self.checkpoint != f"{self._trained.step:08d}.safetensors":
            self._trained = load_run(self._folder)
        return self._trained


def _yield_to_training() -> None:
    """Run at a lower priority from now on, once: who looks at a run should not hold it up."""
    if hasattr(os, "nice") and os.nice(0) < _NICE:
        os.nice(_NICE - os.nice(0))


def open_frame_source(path: Path) -> BakedFrameSource:
    """Open a `.4dv` file or a run's folder.

    Raises UserError: one line that names the file and the mend.
    """
    if not path.exists():
        raise UserError(f"{path}: expected a .4dv file or a run's folder, got nothing there; check the path")
    source: BakedFrameSource = RunSource(path) if path.is_dir() else SceneReader(path)
    manifest = source.manifest
    if manifest.frame_count == 0:
        source.close()
        raise UserError(f"{path}: expected at least one frame, got a scene of none; export it again")
    if manifest.points and not any(manifest.points) and manifest.background_nbytes == 0:
        source.close()
        raise UserError(f"{path}: expected points in some frame, got a scene of none; export it again")
    return source
