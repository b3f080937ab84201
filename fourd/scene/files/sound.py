"""The sound of a scene: its description in the manifest, and the checks of the member that contains it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from msgspec import Meta

from fourd.base.json_file import decode_json
from fourd.recording.soundtrack.ogg import MAX_CHANNELS, OggError, inspect_opus

SOUND_NAME = "sound.ogg"
"""Member with the sound: Opus in an Ogg file."""
MAX_SECONDS = 1e6
MAX_BYTES_PER_SECOND = 64_000
"""Opus has at most 510 kbit/s."""
HEADER_BYTES = 1 << 16
TOLERANCE_SECONDS = 0.1
"""The sound may end this time after the last frame, and may last this much longer or shorter than declared."""


@dataclass(frozen=True)
class SceneSound:
    """The sound of a scene.

    Attributes:
        start: time of its first sample in seconds, counted from the start of frame 0, at least 0.
        duration: in seconds.
        channels: 1 or 2.
        bytes: size of the member with the sound.
        codec: the codec.

    Raises:
        ValueError: if the size does not fit the duration. The message says what was expected.
    """

    start: Annotated[float, Meta(ge=0, le=MAX_SECONDS)]
    duration: Annotated[float, Meta(gt=0, le=MAX_SECONDS)]
    channels: Annotated[int, Meta(ge=1, le=MAX_CHANNELS)]
    bytes: Annotated[int, Meta(ge=1, le=1 << 40)]
    codec: Literal["opus"] = "opus"

    def __post_init__(self) -> None:
        most = HEADER_BYTES + round(MAX_BYTES_PER_SECOND * self.duration)
        if self.bytes > most:
            raise ValueError(f"expected at most {most} bytes for {self.duration:g} s of sound, got {self.bytes}")

    def require_inside(self, seconds: float) -> None:
        """Raise ValueError if the sound does not end with a scene of ``seconds`` s."""
        end = self.start + self.duration
        if end > seconds + TOLERANCE_SECONDS:
            raise ValueError(f"sound: expected sound that ends with the scene, at {seconds:g} s, got an end at {end:g}")


@dataclass(frozen=True, eq=False)
class OpusSound:
    """Sound to be stored in a scene.

    Attributes:
        content: Opus in an Ogg file.
        start: time of its first sample in seconds, counted from the start of frame 0, at least 0.
    """

    content: bytes
    start: float = 0.0

    def describe(self) -> SceneSound:
        """Return the description for the manifest. Raises
        :class:`~fourd.recording.soundtrack.ogg.OggError`, a ValueError, for another file."""
        info = inspect_opus(self.content)
        return SceneSound(self.start, info.seconds, info.channels, len(self.content))


@dataclass(frozen=True)
class _WithSound:
    sound: SceneSound


def check_sound(content: bytes, sound: SceneSound) -> None:
    """Raise :class:`~fourd.recording.soundtrack.ogg.OggError` if the content of the member is not the sound that the
    manifest describes. The content is not decoded."""
    info = inspect_opus(content)
    if info.channels != sound.channels:
        raise OggError(f"expected {sound.channels} channels of sound, got {info.channels}")
    if abs(info.seconds - sound.duration) > TOLERANCE_SECONDS:
        raise OggError(f"expected {sound.duration:g} s of sound, got {info.seconds:g}")


def sound_to_json(sound: SceneSound | None) -> dict[str, Any]:
    """Return the keys of the manifest that describe the sound."""
    return {} if sound is None else {"sound": asdict(sound)}


def sound_from_json(manifest: dict[str, Any], seconds: float) -> SceneSound | None:
    """Parse and check the description of the sound of a scene of ``seconds`` s. Raises ValueError."""
    if "sound" not in manifest:
        return None
    sound = decode_json(manifest, _WithSound).sound
    sound.require_inside(seconds)
    return sound
