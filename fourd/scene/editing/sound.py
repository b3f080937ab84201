"""The sound of an edited scene."""

from __future__ import annotations

from fourd.base.progress import Log
from fourd.recording.soundtrack.captures import Span, cut_sound
from fourd.scene.container import SceneReader
from fourd.scene.files.sound import OpusSound


def edited_sound(reader: SceneReader, chosen: range, speed: float, log: Log) -> OpusSound | None:
    """Return the sound of the frames ``chosen`` of a scene, or None if there is none.

    The sound is decoded and encoded again if it is cut. It is left out, with one line to ``log``, if the frames play at
    another speed than they were recorded.

    Raises UserError if the sound is damaged.
    """
    sound, described = reader.read_sound(), reader.manifest.sound
    if sound is None or described is None:
        return None
    if chosen.step != 1 or speed != 1:
        log("the sound is left out, because the edited scene plays at another speed")
        return None
    if len(chosen) == reader.manifest.frame_count:
        return sound
    fps = reader.manifest.fps
    begin, end = chosen.start / fps, chosen.stop / fps
    first, last = max(begin, sound.start), min(end, sound.start + described.duration)
    if last - first < 0.5 / fps:
        log("the sound is left out, because none belongs to the kept frames")
        return None
    return OpusSound(cut_sound(sound.content, Span(first - sound.start, last - first)), first - begin)
