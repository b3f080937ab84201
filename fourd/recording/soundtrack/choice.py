"""The choice of the soundtrack that a capture keeps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from fourd.base.errors import UserError
from fourd.base.processes.isolation import ParserProcess
from fourd.base.progress import Log, Track
from fourd.recording.soundtrack.reading import SoundLevel

AUTO, NONE = "auto", "none"
"""Values of --sound that are no name: the best soundtrack of the videos, and no sound."""
MODULE = "fourd.recording.soundtrack.reading"
SILENCE_RMS = 1e-4
MAX_CLIPPED = 1e-4
"""A soundtrack counts as clipped if more than this share of its samples is."""
MIN_RATE = 32_000
"""Sampling rates in Hz from which on soundtracks count as equally good: listeners hear up to 16 kHz in most music."""
CPU_SECONDS_PER_SECOND = 0.2
"""CPU time in seconds that the child process may use for each second of a soundtrack."""


@dataclass(frozen=True)
class Recording:
    """A file with a soundtrack.

    Attributes:
        path: the file.
        begin: time at which the wanted sound begins on the clock of the file, in seconds.
    """

    path: Path
    begin: float


@dataclass(frozen=True, eq=False)
class Soundtrack:
    """A soundtrack on the clock of a capture.

    Attributes:
        content: an Ogg file with Opus.
        channels: 1 or 2.
        note: one line that says which soundtrack was chosen, and why.
    """

    content: bytes
    channels: int
    note: str


def choose_sound(
    wanted: str,
    recordings: Mapping[str, Recording],
    seconds: float,
    log: Log,
    track: Track,
    begin: float = 0.0,
) -> Soundtrack | None:
    """Choose the soundtrack of a capture, and encode it.

    Args:
        wanted: the value of --sound: "auto", "none", the name of a camera, or a file.
        recordings: the videos by camera name.
        seconds: duration of the sound.
        log: called with a line for each soundtrack that cannot be read. It is left out, because it is optional.
        track: reports progress.
        begin: time at which the sound begins, in seconds from frame 0 of the capture. It is that of a named file.

    Returns the soundtrack, or None if there is none or none is wanted.

    Raises:
        UserError: if the user has named a camera or a file whose sound cannot be used.
    """
    if wanted == NONE:
        return None
    with ParserProcess() as parser:
        if wanted == AUTO:
            levels = {}
            for name in track(list(recordings), len(recordings), "soundtracks"):
                try:
                    level = _measure(recordings[name], seconds, parser)
                except UserError as error:
                    log(f"the sound of {name} is left out: {str(error).rpartition('; ')[0]}")
                    continue
                if level is not None:
                    levels[name] = level
            best = best_sound(levels)
            if best is None:
                return None
            note = describe_choice(best, levels)
            return _encoded(recordings[best], seconds, note, parser)
        recording = recordings.get(wanted)
        if recording is not None:
            return _encoded(recording, seconds, f"sound: {wanted}", parser)
        return _encoded(Recording(_file(wanted, recordings), begin), seconds, f"sound: {wanted}", parser)


def best_sound(levels: Mapping[str, SoundLevel]) -> str | None:
    """Return the name of the best soundtrack, or None if all are silent. Soundtracks that are not clipped come first,
    then those with a high sampling rate, then the loudest."""
    heard = {name: level for name, level in levels.items() if level.rms >= SILENCE_RMS}
    if not heard:
        return None
    return max(heard, key=lambda name: _quality(heard[name]))


def describe_choice(best: str, levels: Mapping[str, SoundLevel]) -> str:
    """Return a line that names the chosen soundtrack, and says why it was chosen."""
    level = levels[best]
    loudness = f"{20 * math.log10(level.rms):.0f} dB"
    kind = "stereo" if level.channels == 2 else "mono"
    if len(levels) == 1:
        why = "the only soundtrack"
    elif level.clipped > MAX_CLIPPED:
        why = f"the least clipped of {len(levels)} soundtracks"
    else:
        why = f"the best of {len(levels)} soundtracks: not clipped, and loud; --sound CAM chooses another"
    return f"sound: {best}, {level.rate / 1000:g} kHz, {kind}, {loudness}, {why}"


def _quality(level: SoundLevel) -> tuple[float, ...]:
    clipped = level.clipped if level.clipped > MAX_CLIPPED else 0.0
    return (-clipped, min(level.rate, MIN_RATE), level.rms)


def _measure(recording: Recording, seconds: float, parser: ParserProcess) -> SoundLevel | None:
    more = CPU_SECONDS_PER_SECOND * (seconds + max(recording.begin, 0))
    reply = parser.call(f"{MODULE}:measure_in_child", recording.path, recording.begin, seconds, more_seconds=more)
    return None if reply.value is None else msgspec.convert(reply.value, SoundLevel)


def _encoded(recording: Recording, seconds: float, note: str, parser: ParserProcess) -> Soundtrack:
    more = CPU_SECONDS_PER_SECOND * (seconds + max(recording.begin, 0))
    reply = parser.call(f"{MODULE}:encode_in_child", recording.path, recording.begin, seconds, more_seconds=more)
    return Soundtrack(reply.content, msgspec.convert(reply.value, int), note)


def _file(wanted: str, recordings: Mapping[str, Recording]) -> Path:
    path = Path(wanted)
    if not path.is_file():
        names = ", ".join(recordings) or "no camera with a video"
        raise UserError(
            f"--sound {wanted}: expected auto, none, a file or a camera among {names}, got another name; check it"
        )
    return path
