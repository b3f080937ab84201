"""Select the cameras, frames and image scale that a run uses, and the held-out cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fourd.base.errors import UserError
from fourd.base.progress import Log
from fourd.reconstruction.training.cameras.calibration import with_start_cameras
from fourd.recording.capture import Capture, open_capture, read_calibration
from fourd.recording.capture.layout import select_views
from fourd.recording.capture.split import NAME as SPLIT_NAME
from fourd.recording.capture.split import read_test_views, require_known

if TYPE_CHECKING:
    from fourd.reconstruction.training.config import TrainConfig

DECODED_MB = 32
"""Size of the cache of decoded whole images, in MiB. Training uses a separate cache for cropped images."""


@dataclass(frozen=True)
class DataSelection:
    """The part of a capture that a run uses: views, frames and image scale. Each field has the meaning of the field of
    :class:`TrainConfig` with the same name."""

    views: tuple[str, ...] | None = None
    test_views: tuple[str, ...] = ()
    frames: str | None = None
    image_scale: float = 1.0

    @classmethod
    def of(cls, train: TrainConfig) -> DataSelection:
        """Return the views, frames and image scale that a training config selects."""
        return cls(train.views, train.test_views or (), train.frames, train.image_scale)


def with_test_split(train: TrainConfig, capture: Path, log: Log) -> TrainConfig:
    """Return a training config whose ``test_views`` is set. If it is null, the test split of the capture is used.

    Raises:
        UserError: if the test split is damaged or names an unknown camera.
    """
    split = read_test_views(capture) if train.test_views is None else None
    if split is None:
        return replace(train, test_views=train.test_views or ())
    require_known(capture, split, list(read_calibration(capture)))
    # Cameras that the user leaves out with --views cannot be held out.
    chosen = None if train.views is None else select_views(train.views, list(read_calibration(capture)))
    held_out = tuple(name for name in split if chosen is None or name in chosen)
    if held_out:
        log(
            f"held out: {', '.join(held_out)}, the test split in {capture / SPLIT_NAME}; to train on all cameras, add "
            "--test-views none"
        )
    return replace(train, test_views=held_out)


@dataclass(frozen=True)
class RunViews:
    """An open capture and the roles of its cameras.

    Attributes:
        capture: the capture, reduced to the selected frames and to the training cameras and held-out cameras.
        training: indices of the training cameras in ``capture.cameras``.
        test: indices of the held-out cameras in ``capture.cameras``.
    """

    capture: Capture
    training: list[int]
    test: list[int]

    def __enter__(self) -> RunViews:
        return self

    def __exit__(self, *exception: object) -> None:
        self.capture.close()

    @property
    def training_names(self) -> tuple[str, ...]:
        """Names of the training cameras."""
        return tuple(self.capture.names[index] for index in self.training)


def open_run_views(path: Path, selection: DataSelection, run: Path | None = None) -> RunViews:
    """Open the selected part of the capture in ``path``.

    Args:
        path: the capture's folder.
        selection: the views, frames and image scale to use.
        run: folder of a run whose start cameras (the cameras with which its training starts) replace the capture's
            cameras; if None, the capture's cameras are used.

    Raises:
        UserError: a view or frame is unknown, there are fewer than two training views, or start cameras are missing.
    """
    views = None if selection.views is None else list(selection.views)
    capture = open_capture(path, views=views, frames=selection.frames, scale=selection.image_scale, cache_mb=DECODED_MB)
    held_out = select_views(selection.test_views, capture.names, "--test-views") if selection.test_views else []
    test = [capture.names.index(name) for name in held_out]
    training = [index for index in range(len(capture.names)) if index not in test]
    if len(capture.names) < 2:
        raise UserError(
            f"{path}: expected at least 2 cameras, got {len(capture.names)}; add recordings of other cameras, or "
            "choose more --views"
        )
    if len(training) < 2:
        raise UserError(
            f"{path}: expected at least 2 training views, got {len(training)}; hold out fewer views with --test-views"
        )
    if run is not None:
        capture = with_start_cameras(capture, run)
    return RunViews(capture, training, test)
