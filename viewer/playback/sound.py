"""Plays the sound of the scene in the window through a sound device, with the package sounddevice."""

from __future__ import annotations

import threading
from typing import Any, Protocol

from fourd.recording.soundtrack.ogg import RATE, OggError
from fourd.scene import SceneManifest
from fourd.scene.files.sound import OpusSound
from fourd.viewer.playback.clock import Playback
from fourd.viewer.playback.sound_feed import SoundFeed, decode_scene_sound


class ScenePlayed(Protocol):
    """What the player needs of a scene that the window shows."""

    @property
    def path(self) -> object:
        """The file or folder, for messages."""

    @property
    def manifest(self) -> SceneManifest:
        """The manifest of the scene."""

    @property
    def sound(self) -> OpusSound | None:
        """The sound, or None if there is none."""


class SoundPlayer:
    """Plays the sound of one scene after the other. A machine without a sound device plays none, and says so once.

    Attributes:
        is_on: whether sound is played.
    """

    def __init__(self) -> None:
        self.is_on = True
        self._scene: ScenePlayed | None = None
        self._feed: SoundFeed | None = None
        self._stream: Any = None
        self._problem = ""
        self._has_failed = False
        self._opener: threading.Thread | None = None

    def toggle(self) -> None:
        """Switch the sound on or off."""
        self.is_on = not self.is_on

    def follow(self, scene: ScenePlayed | None, playback: Playback, *, is_waiting: bool) -> None:
        """Play the sound of the time that the picture shows. ``is_waiting`` is true while the picture stands still
        because a frame is being read."""
        if scene is not self._scene:
            self.close()
            self._scene = scene
            if scene is not None and scene.sound is not None and not self._has_failed:
                self._opener = threading.Thread(target=self._open, args=(scene,), name="sound", daemon=True)
                self._opener.start()
        feed, stream = self._feed, self._stream
        if feed is None or stream is None:
            return
        is_running = self.is_on and playback.is_playing and not is_waiting and playback.frame_count > 1
        feed.follow(
            playback.seconds, playback.speed, stream.time, is_running=is_running, is_looping=playback.is_looping
        )

    @property
    def jumps(self) -> int:
        """How often the sound of this scene has been started or moved to the time of the picture."""
        return 0 if self._feed is None else self._feed.jumps

    def drift(self, playback: Playback) -> float | None:
        """Return how far the sound is ahead of the picture, in seconds, or None if no sound is played."""
        if self._feed is None or self._stream is None:
            return None
        return self._feed.drift(playback.seconds, self._stream.time)

    def take_problem(self) -> str:
        """Return why there is no sound, once, or an empty string."""
        problem, self._problem = self._problem, ""
        return problem

    def close(self) -> None:
        """Close the sound device."""
        if self._opener is not None:
            self._opener.join()
        if self._stream is not None:
            self._stream.close()
        self._opener = self._stream = self._feed = None

    def _open(self, scene: ScenePlayed) -> None:
        """Decode the sound and open the device, which can take a second."""
        sound, described = scene.sound, scene.manifest.sound
        assert sound is not None
        assert described is not None
        try:
            feed = SoundFeed(decode_scene_sound(sound, described.channels, scene.manifest.seconds))
            self._stream = _open_stream(feed)
        except OggError as error:
            self._problem = f"{scene.path}: no sound: {error}; export the scene again"
        except ImportError:
            self._fail("the package sounddevice is missing; pip install 'fourd[viewer]'")
        except OSError as error:
            self._fail(f"{error}; install PortAudio (on Debian and Ubuntu: apt install libportaudio2)")
        except RuntimeError as error:
            self._fail(f"no sound device can be opened ({error})")
        else:
            self._feed = feed

    def _fail(self, reason: str) -> None:
        self._has_failed = True
        self._problem = f"the scene is played without sound: {reason}"


def _open_stream(feed: SoundFeed) -> Any:
    """Open the default sound device, and play what ``feed`` supplies. Raises ImportError if the package is missing,
    OSError if its library is missing, and RuntimeError if there is no device."""
    import sounddevice

    def play(out: Any, count: int, times: Any, status: Any) -> None:
        # Some systems do not tell when the samples will be heard.
        at = times.outputBufferDacTime or stream.time + stream.latency
        feed.fill(out, at)

    try:
        stream = sounddevice.OutputStream(samplerate=RATE, channels=feed.channels, dtype="float32", callback=play)
        stream.start()
    except sounddevice.PortAudioError as error:
        raise RuntimeError(str(error).split(":")[-1].strip()) from error
    return stream
