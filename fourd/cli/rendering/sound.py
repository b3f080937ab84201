"""The sound of the videos that `fourd render` writes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from typing import TYPE_CHECKING

from rich.console import Console

from fourd.base.storage import Location, StorageUrl

if TYPE_CHECKING:
    from fourd.viewer.output.sound import VideoSound


def video_sound(source: Location, frames: Sequence[int], fps: float, console: Console) -> VideoSound | None:
    """Return the sound of a video of a `.4dv` scene, or None. If sound is left out, a line says why.

    Args:
        source: the source of the images.
        frames: for each image of the video, the index of the frame that it shows.
        fps: images per second.
        console: console for the line.
    """
    from fourd.scene.container import SceneReader
    from fourd.viewer.output.sound import sound_of_video

    if not isinstance(source, StorageUrl) and (source.is_dir() or source.suffix.lower() != ".4dv"):
        return None
    with closing(SceneReader(source)) as reader:
        found = sound_of_video(reader.read_sound(), reader.manifest, frames, fps)
    if isinstance(found, str):
        console.print(found, soft_wrap=True)
        return None
    return found
