"""The sound of the window: what a sound device is given, and when."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fourd.scene import SceneReader
from fourd.viewer.loaded_scene import LoadedScene
from fourd.viewer.playback.clock import Playback
from fourd.viewer.playback.sound import SoundPlayer
from fourd.viewer.playback.sound_feed import MAX_DRIFT_SECONDS, SoundFeed, decode_scene_sound
from tests.sound.claps import FPS, RATE, onsets, write_clap_scene

CLAP, SECONDS = 20 / FPS, 2.0
BLOCK = 512


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of 2 s with a clap at 0.667 s. Tests must not change it."""
    return write_clap_scene(tmp_path_factory.mktemp("clap") / "clap.4dv", points=50, start=0.25)


@pytest.fixture
def feed(scene: Path) -> SoundFeed:
    reader = SceneReader(scene)
    sound = reader.read_sound()
    assert sound is not None
    return SoundFeed(decode_scene_sound(sound, 1, SECONDS))


class Device:
    """A sound device on a clock of its own, whose samples are heard ``latency`` s after it asks for them. ``rate`` is
    how many of its seconds pass in a second of the picture."""

    def __init__(self, feed: SoundFeed, latency: float = 0.1, rate: float = 1.0) -> None:
        self.feed, self.latency, self.rate = feed, latency, rate
        self.played = 0
        self.heard: list[np.ndarray] = []

    @property
    def now(self) -> float:
        """The time of the device's clock, which started 100 s ago."""
        return 100 + self.played / RATE

    def play_until(self, seconds: float) -> None:
        """Play until the time ``seconds`` of the picture's clock."""
        while self.played / RATE < seconds * self.rate:
            out = np.zeros((BLOCK, self.feed.channels), np.float32)
            self.feed.fill(out, self.now + self.latency)
            self.heard.append(out)
            self.played += BLOCK

    @property
    def claps(self) -> list[float]:
        """The times of the picture's clock at which claps are heard."""
        samples = np.concatenate(self.heard).T
        return [(time + self.latency) / self.rate for time in onsets(samples)]


def play(feed: SoundFeed, device: Device, playback: Playback, seconds: float) -> list[float]:
    """Play the picture at 60 images per second, and return the times at which it shows the clap."""
    shown, before = [], -1
    for step in range(round(seconds * 60)):
        now = step / 60
        feed.follow(
            playback.seconds, playback.speed, device.now, is_running=playback.is_playing, is_looping=playback.is_looping
        )
        at = round(CLAP * playback.fps)
        if before < at <= playback.frame:
            shown.append(now)
        before = playback.frame
        device.play_until(now)
        playback.advance(1 / 60)
    return shown


@pytest.mark.parametrize("latency", [0.01, 0.2])
def test_a_minute_of_loops(feed: SoundFeed, latency: float) -> None:
    """Catches a latency of the device that is ignored, and sound that drifts from loop to loop."""
    device = Device(feed, latency)
    shown = play(feed, device, Playback(60, FPS), 60)
    heard = device.claps
    assert len(shown) == 30
    pairs = [min(heard, key=lambda time: abs(time - seen)) - seen for seen in shown]
    assert max(map(abs, pairs)) < MAX_DRIFT_SECONDS
    assert feed.jumps == 1


def test_a_device_that_is_slow_is_corrected(feed: SoundFeed) -> None:
    """Catches the drift of a device whose clock differs from that of the picture by 0.2%, 120 ms in a minute."""
    device = Device(feed, rate=1.002)
    shown = play(feed, device, Playback(60, FPS), 60)
    pairs = [min(device.claps, key=lambda time: abs(time - seen)) - seen for seen in shown]
    assert max(map(abs, pairs)) < MAX_DRIFT_SECONDS + 0.02
    assert 2 <= feed.jumps <= 5


def test_seeks_move_the_sound(feed: SoundFeed) -> None:
    """Catches sound that goes on at its old place after a seek, and one that stops."""
    device, playback = Device(feed, latency=0.03), Playback(60, FPS)
    rng = np.random.default_rng(0)
    shown, start = [], 0.0
    for frame in rng.integers(0, 19, 10):
        playback.seek(int(frame))
        for step in range(60):
            now = start + step / 60
            feed.follow(playback.seconds, 1.0, device.now, is_running=True)
            if playback.frame == 20 and (not shown or now - shown[-1] > 0.1):
                shown.append(now)
            device.play_until(now)
            playback.advance(1 / 60)
        start += 1
    assert len(shown) == 10
    lags = [min(device.claps, key=lambda time: abs(time - seen)) - seen for seen in shown]
    assert max(map(abs, lags)) < MAX_DRIFT_SECONDS


@pytest.mark.parametrize(("speed", "expected"), [(2.0, CLAP / 2), (0.5, 2 * CLAP), (-1.0, SECONDS - CLAP)])
def test_other_speeds(feed: SoundFeed, speed: float, expected: float) -> None:
    """Catches sound that plays at its own speed under a picture that does not."""
    device, playback = Device(feed, latency=0.0), Playback(60, FPS, speed=speed, is_looping=False)
    if speed < 0:
        playback.seek(59)
    play(feed, device, playback, 3)
    assert device.claps[:1] == pytest.approx([expected], abs=0.045)
    assert len(device.claps) == 1


def test_pauses_are_silent_and_without_clicks(feed: SoundFeed) -> None:
    """Catches sound that goes on while the picture stands still, and steps in it, which are heard as clicks."""
    device, playback = Device(feed), Playback(60, FPS, is_playing=False)
    assert play(feed, device, playback, 2) == []
    assert not np.concatenate(device.heard).any()
    tone = SoundFeed(np.full((RATE, 1), 16_384, np.int16))
    device = Device(tone, latency=0.0)
    for running in (True, False, True, False):
        for step in range(10):
            tone.follow(step / 60, 1.0, device.now, is_running=running)
            device.play_until(device.played / RATE + 1 / 60)
    steps = np.abs(np.diff(np.concatenate(device.heard)[:, 0]))
    assert steps.max() < 0.01


def test_sound_stops_if_nobody_follows(feed: SoundFeed, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches sound that goes on while a video is rendered or the window is hidden."""
    device = Device(feed)
    feed.follow(0.0, 1.0, device.now, is_running=True)
    later = time.monotonic() + 2
    monkeypatch.setattr(time, "monotonic", lambda: later)
    device.play_until(2)
    assert not np.concatenate(device.heard).any()


@pytest.fixture
def loaded(scene: Path) -> Iterator[LoadedScene]:
    opened = LoadedScene(scene, SceneReader(scene))
    yield opened
    opened.close()


def test_a_machine_without_sound_says_so_once(loaded: LoadedScene) -> None:
    """Catches a viewer that ends, or tells again and again, where there is no sound library or no device."""
    player, playback = SoundPlayer(), Playback(60, FPS)
    told = []
    for _ in range(3):
        for scene in (loaded, None):
            player.follow(scene, playback, is_waiting=False)
            player.close()
            told.append(player.take_problem())
    problems = [line for line in told if line]
    assert len(problems) <= 1
    assert all("\n" not in line and line.startswith("the scene is played without sound: ") for line in problems)
