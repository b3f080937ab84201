"""The sound of a video that is rendered from a scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from fourd.recording.soundtrack.captures import Span
from fourd.recording.soundtrack.ogg import RATE
from fourd.recording.soundtrack.opus import Samples, cut, decode_opus
from fourd.scene.files.sound import OpusSound, SceneSound
from fourd.scene.scene import SceneManifest

LEFT_OUT = "the sound is left out, because the scene does not play at its own speed in this video"


@dataclass(frozen=True, eq=False)
class VideoSound:
    """The sound of a video.

    Attributes:
        sound: the sound of the scene.
        described: its description.
        parts: the parts of the scene that the video shows, one after the other.
    """

    sound: OpusSound
    described: SceneSound
    parts: tuple[Span, ...]

    @property
    def channels(self) -> int:
        return self.described.channels

    def blocks(self) -> Iterator[Samples]:
        """Yield the samples (C, N) of the whole video at 48 kHz, block by block."""
        written, end = 0, 0.0
        for part in self.parts:
            end += part.seconds
            count = round(end * RATE) - written
            begin = round((part.begin - self.sound.start) * RATE)
            yield from cut(decode_opus(self.sound.content), begin, count, self.channels)
            written += count


def sound_of_video(
    sound: OpusSound | None, manifest: SceneManifest, frames: Sequence[int], fps: float
) -> VideoSound | str | None:
    """Return the sound of a video, or None if the scene has no sound, or a line that says why it is left out.

    Args:
        sound: the sound of the scene.
        manifest: the manifest of the scene.
        frames: for each image of the video, the index of the frame that it shows.
        fps: images per second.
    """
    if sound is None or manifest.sound is None:
        return None
    parts = parts_at_speed(frames, fps, manifest.fps)
    return LEFT_OUT if parts is None else VideoSound(sound, manifest.sound, parts)


def parts_at_speed(frames: Sequence[int], fps: float, scene_fps: float) -> tuple[Span, ...] | None:
    """Divide a video into parts in which the scene plays at its own speed. A part ends where the scene begins again.

    Returns None if the scene plays at another speed or backwards, or if its time stands still.
    """
    # A frame is shown up to one frame of the scene and one image of the video before or after its time.
    tolerance = 1.01 * max(1 / fps, 1 / scene_fps)
    starts = [0] + [index for index, (one, other) in enumerate(pairwise(frames), 1) if other < one]
    ends = [*starts[1:], len(frames)]
    # In a loop, the scene begins again at its first frame; if it plays backwards, each image is an earlier frame.
    if not frames or any(frames[start] != min(frames) for start in starts[1:]):
        return None
    for start, end in zip(starts, ends, strict=True):
        for index in range(start, end):
            elapsed, played = (index - start) / fps, (frames[index] - frames[start]) / scene_fps
            if abs(played - elapsed) > tolerance:
                return None
    if len(frames) > 1 and len(set(frames)) == 1:
        return None
    return tuple(Span(frames[start] / scene_fps, (end - start) / fps) for start, end in zip(starts, ends, strict=True))
