"""The sound of the frames that are selected from a capture."""

from __future__ import annotations

from fourd.base.progress import Log, Track
from fourd.recording.capture.reader import Capture
from fourd.recording.soundtrack.captures import Span, capture_sound
from fourd.recording.soundtrack.choice import AUTO, NONE

MAX_RATE_ERROR = 1e-3
"""Relative difference of two frame rates that count as equal: at this one, sound and picture drift apart by 60 ms in a
minute."""


def clip_sound(
    capture: Capture, wanted: str, fps: float | None, log: Log, track: Track, *, uses_videos: bool = True
) -> bytes | None:
    """Return the sound of the selected frames of a capture, Opus in an Ogg file, or None if there is none.

    Args:
        capture: the capture. Its frames are evenly spaced.
        wanted: the value of --sound, see :func:`~fourd.recording.soundtrack.choice.choose_sound`.
        fps: rate in 1/s at which the frames will play, or None for the rate of the capture.
        log: called with one line that says which sound was chosen, or why sound is left out.
        track: reports progress.
        uses_videos: see :func:`~fourd.recording.soundtrack.captures.capture_sound`.

    Raises:
        UserError: if the sound that the user named, or sound.ogg, cannot be read.
    """
    numbers, rate = capture.frame_numbers, capture.fps
    if wanted == NONE or len(numbers) < 2:
        return None
    if rate is None:
        if wanted != AUTO:
            log("the sound is left out, because the frame rate of the images is not known; set it with --fps")
        return None
    if fps is not None and abs(fps / rate - 1) > MAX_RATE_ERROR:
        log(f"the sound is left out, because the scene plays at {fps:g} frames per second, not at {rate:g}")
        return None
    step = numbers[1] - numbers[0]
    span = Span(numbers[0] / (rate * step), len(numbers) / rate)
    return capture_sound(capture.path, wanted, span, log, track, uses_videos=uses_videos)
