"""The sound of a capture: its file sound.ogg, or the soundtracks of its videos."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.files import write_bytes_atomically
from fourd.base.limits import read_limited
from fourd.base.progress import Log, Track
from fourd.recording.capture.layout import VIDEOS
from fourd.recording.capture.video_list import Video, common_frames, common_rate, list_videos
from fourd.recording.soundtrack.choice import AUTO, Recording, choose_sound
from fourd.recording.soundtrack.ogg import RATE, OggError, inspect_opus
from fourd.recording.soundtrack.opus import Samples, cut, decode_opus, encode_opus

NAME = "sound.ogg"
"""File in a capture with its sound, Opus in an Ogg file, whose first sample is at the time of frame 0."""
MAX_BYTES = 1 << 30


@dataclass(frozen=True)
class Span:
    """A part of a capture or a scene: ``seconds`` s from the time ``begin``, in seconds from frame 0."""

    begin: float
    seconds: float


def recordings_of(videos: Mapping[str, Video]) -> dict[str, Recording]:
    """Return the videos of a capture as recordings of its sound."""
    return {
        name: Recording(video.path, float(Fraction(video.index.start) + video.seconds(0)))
        for name, video in videos.items()
    }


def keep_sound(out: Path, wanted: str, videos: Mapping[str, Video], track: Track) -> list[str]:
    """Write the sound of the whole capture ``out`` as sound.ogg, or remove this file if there is no sound.

    ``wanted`` is the value of --sound, see :func:`~fourd.recording.soundtrack.choice.choose_sound`. Returns lines
    on the soundtracks for the user.
    """
    rate, found, notes = common_rate(videos), None, list[str]()
    if rate is not None:
        found = choose_sound(wanted, recordings_of(videos), float(common_frames(videos) / rate), notes.append, track)
    elif wanted not in (AUTO, "none"):
        raise UserError(f"--sound {wanted}: expected videos, got images; name the sound when the scene is made")
    if found is None:
        (out / NAME).unlink(missing_ok=True)
        return notes
    write_bytes_atomically(out / NAME, found.content)
    return [*notes, found.note]


def capture_sound(
    capture: Path, wanted: str, span: Span, log: Log, track: Track, *, uses_videos: bool = True
) -> bytes | None:
    """Return the sound of a part of a capture, an Ogg file with Opus whose first sample is at ``span.begin``, or None.

    Args:
        capture: the capture's folder.
        wanted: the value of --sound. With "auto", sound.ogg is used if it exists.
        span: the part of the capture.
        log: called with one line that says which sound was chosen.
        track: reports progress.
        uses_videos: whether "auto" looks at the videos of a capture without sound.ogg.

    Raises:
        UserError: if sound.ogg or the named sound cannot be read.
    """
    path = capture / NAME
    if wanted == AUTO and path.is_file():
        try:
            content = cut_sound(read_limited(path, MAX_BYTES), span)
        except (OggError, ValueError, OSError) as error:
            raise UserError(f"{path}: {error}; import the capture again, or remove the file") from error
        log(f"sound: {path}")
        return content
    if wanted == AUTO and not uses_videos:
        return None
    videos = list_videos(capture) if (capture / VIDEOS).is_dir() else {}
    shifted = {
        name: replace(recording, begin=recording.begin + span.begin)
        for name, recording in recordings_of(videos).items()
    }
    found = choose_sound(wanted, shifted, span.seconds, log, track, begin=span.begin)
    if found is None:
        return None
    log(found.note)
    return found.content


def cut_sound(content: bytes, span: Span) -> bytes:
    """Return a part of an Ogg file, encoded again unless it is the whole file. The part is shorter than ``span`` if the
    sound ends earlier.

    Raises:
        OggError: if the file is damaged, or if the sound ends before ``span`` begins.
    """
    info = inspect_opus(content)
    begin = round(span.begin * RATE)
    count = min(round(span.seconds * RATE), info.samples - begin)
    if count < 1:
        raise OggError(f"expected sound at {span.begin:g} s, got one that ends after {info.seconds:g} s")
    if begin == 0 and count == info.samples:
        return content
    return encode_opus(_part(content, begin, count, info.channels), info.channels)


def _part(content: bytes, begin: int, count: int, channels: int) -> Iterator[Samples]:
    return cut(decode_opus(content), begin, count, channels)
