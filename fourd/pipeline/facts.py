"""The facts about a capture on which the choice of its stages depends."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fourd.recording.capture.layout import INTRINSICS_NAME, VIDEOS, camera_folders, camera_names, select_views
from fourd.recording.capture.pictures.alpha import alpha_is_matte
from fourd.recording.capture.pictures.listing import masked_cameras

MASKS = "masks"


@dataclass(frozen=True)
class MaskFacts:
    """Which cameras have masks that the user provided, in the folder masks/ or in the alpha channels of the images.

    Attributes:
        cameras: the names of all cameras.
        masked: the names of the cameras with masks.
        has_masks: whether the user provided masks. True even if they belong to no camera of the capture.
    """

    cameras: tuple[str, ...]
    masked: tuple[str, ...]
    has_masks: bool

    @staticmethod
    def read(capture: Path) -> MaskFacts:
        """Read the facts about the masks of a capture."""
        return MaskFacts(tuple(camera_names(capture)), tuple(masked_cameras(capture)), has_masks(capture))

    def complete(self) -> MaskFacts:
        """Return the facts of the same capture with masks of all cameras."""
        return MaskFacts(self.cameras, self.cameras, True)

    def partly_masked(self, views: Sequence[str] | None) -> list[str]:
        """Return the selected cameras if some of them have no masks, otherwise an empty list. If ``views`` is None, all
        cameras are selected."""
        names = select_views(views, self.cameras)
        return [] if set(names) <= set(self.masked) else names

    def lacks_masks(self, views: Sequence[str] | None = None) -> bool:
        """Return True if the user provided no masks of one or more of the selected cameras."""
        return not self.has_masks or bool(self.partly_masked(views))


def has_masks(capture: Path) -> bool:
    """Return True if the user provided masks, in the capture's folder masks/ or in the alpha channels of its images."""
    return bool(camera_folders(capture / MASKS)) or alpha_is_matte(capture)


def lacks_masks(capture: Path, views: Sequence[str] | None = None) -> bool:
    """Return True if the user provided no masks of one or more of the cameras ``views``. If ``views`` is None, all
    cameras are meant."""
    return not has_masks(capture) or MaskFacts.read(capture).lacks_masks(views)


def is_usable(source: Path) -> bool:
    """Return True if a folder is a capture that needs no import. A capture without masks of all cameras must be
    writable, because fourd stores the mattes in its folder."""
    is_capture = (source / INTRINSICS_NAME).is_file() and any((source / name).is_dir() for name in ("images", VIDEOS))
    return is_capture and (not lacks_masks(source) or os.access(source, os.W_OK))
