"""Views of a scene that the user has kept, to return to them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from fourd.base.json_file import decode_json
from fourd.viewer.navigation.recorded_path import PathSample
from fourd.viewer.navigation.saved_views import SceneStore, StoredPose, pose_to_json

MAX_BOOKMARKS = 9
"""Number of views that are kept for each scene: one for each key from 1 to 9."""


@dataclass(frozen=True)
class _StoredBookmark(StoredPose):
    frame: Annotated[int, Meta(ge=0, le=1 << 31)]


class Bookmarks:
    """The kept views of the open scene, each with the frame at which it was kept.

    They are stored in a file in the user's state folder, because the folder of a scene may be on a read-only disk. A
    file that cannot be read counts as empty.

    Attributes:
        kept: the views, in the order in which they were kept.
    """

    def __init__(self, file: Path) -> None:
        self.kept: tuple[PathSample, ...] = ()
        self._store = SceneStore(file)
        self._scene: Path | None = None

    def open(self, scene: Path) -> None:
        """Load the views of ``scene``."""
        self._scene = scene
        stored = self._store.load(scene)
        try:
            found = [decode_json(each, _StoredBookmark) for each in stored] if isinstance(stored, list) else []
        except ValueError:
            found = []
        self.kept = tuple(PathSample(each.pose(), each.frame) for each in found[:MAX_BOOKMARKS])

    def add(self, view: PathSample) -> str:
        """Keep a view. Returns a message for the user."""
        if len(self.kept) == MAX_BOOKMARKS:
            return f"expected at most {MAX_BOOKMARKS} bookmarks, got another one; remove one in the section Viewpoint"
        self._set((*self.kept, view))
        return f"bookmark {len(self.kept)}: press {len(self.kept)} to return to this view"

    def remove(self, index: int) -> None:
        """Forget a view. The numbers of the later ones decrease by one."""
        self._set((*self.kept[:index], *self.kept[index + 1 :]))

    def _set(self, kept: tuple[PathSample, ...]) -> None:
        self.kept = kept
        if self._scene is not None:
            self._store.save(self._scene, [{"frame": each.frame, **pose_to_json(each.pose)} for each in kept])
