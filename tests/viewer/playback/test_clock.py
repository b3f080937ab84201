"""The playback clock."""

from __future__ import annotations

import math

import pytest

from fourd.viewer.playback.clock import Playback


def advance(playback: Playback, ticks: int, seconds: float) -> list[int]:
    """The numbers of the frames that the clock shows after each of its steps."""
    frames = []
    for _ in range(ticks):
        playback.advance(seconds)
        frames.append(playback.frame)
    return frames


def test_a_loop_shows_every_frame_for_the_same_time() -> None:
    """Catches a first or last frame that is skipped or shown twice when playback loops."""
    playback = Playback(4, 10.0)
    assert advance(playback, 16, 0.05) == [0, 1, 1, 2, 2, 3, 3, 0] * 2
    assert playback.is_playing


def test_a_loop_backwards() -> None:
    """Catches negative frame numbers, a wrong direction, and a pause at the first frame in backward playback."""
    playback = Playback(4, 10.0, speed=-2.0)
    playback.advance(0.025)
    assert playback.direction == -1
    assert playback.frame == 3
    assert advance(playback, 8, 0.05) == [2, 1, 0, 3] * 2


@pytest.mark.parametrize(("speed", "end"), [(1.0, 4), (-1.0, 0)])
def test_without_loop_playback_pauses_at_the_end(speed: float, end: int) -> None:
    """Catches frame numbers past the end, and playback that does not pause at the end."""
    playback = Playback(5, 10.0, speed=speed, is_looping=False)
    playback.seek(2)
    assert set(advance(playback, 10, 0.125)) <= set(range(5))
    assert (playback.frame, playback.is_playing) == (end, False)
    playback.advance(1.0)
    assert playback.frame == end


def test_the_last_frame_is_shown_for_its_full_duration() -> None:
    """Catches a last frame that is shown for too short a time before the pause."""
    playback = Playback(3, 8.0, is_looping=False)
    assert advance(playback, 2, 0.125) == [1, 2]
    assert playback.is_playing
    playback.advance(0.0625)
    assert playback.is_playing
    playback.advance(0.0625)
    assert not playback.is_playing


@pytest.mark.parametrize("speed", [0.1, 1.0, -3.7, 1e6])
def test_long_and_tiny_ticks_stay_in_range(speed: float) -> None:
    """Catches a frame number past the last frame, from a remainder that rounding increases to the frame count."""
    playback = Playback(7, 30.0, speed=speed)
    for seconds in (1e-18, 1e-18, 1e5, 1e-9, 0.3, 1e-18):
        playback.advance(seconds)
        assert 0 <= playback.frame <= 6


def test_a_pause_holds_the_frame() -> None:
    """Catches time that accumulates during a pause and causes a jump."""
    playback = Playback(5, 10.0)
    playback.advance(0.25)
    playback.toggle()
    playback.advance(100.0)
    assert playback.frame == 2
    playback.toggle()
    playback.advance(0.075)
    assert playback.frame == 3


@pytest.mark.parametrize(("frame", "expected"), [(-3, 0), (0, 0), (2, 2), (4, 4), (99, 4)])
def test_seeking_clamps_to_the_scene(frame: int, expected: int) -> None:
    """Catches a seek to a frame outside the scene, and a seek that pauses playback."""
    playback = Playback(5, 10.0)
    playback.seek(frame)
    assert playback.frame == expected
    assert playback.is_playing


@pytest.mark.parametrize(("start", "steps", "expected"), [(0, 1, 1), (0, -1, 4), (4, 1, 0), (2, -7, 0), (2, 10, 2)])
def test_steps_pause_and_wrap(start: int, steps: int, expected: int) -> None:
    """Catches a step that does not pause playback, or that leaves the frames of the scene."""
    playback = Playback(5, 10.0)
    playback.seek(start)
    playback.step(steps)
    assert playback.frame == expected
    assert not playback.is_playing


def test_steps_start_at_the_current_frame() -> None:
    """Catches a fraction of a frame that remains after a step, so that the next steps are uneven."""
    playback = Playback(5, 10.0)
    playback.advance(0.19)
    playback.step(1)
    assert playback.frame == 2
    playback.step(-2)
    assert playback.frame == 0


@pytest.mark.parametrize(("speed", "start", "end"), [(1.0, 0, 4), (-1.0, 4, 0)])
def test_play_at_the_end_restarts(speed: float, start: int, end: int) -> None:
    """Catches a play button that has no effect at the end of a scene that does not loop."""
    playback = Playback(5, 10.0, speed=speed, is_looping=False)
    playback.seek(end)
    playback.advance(10.0)
    assert not playback.is_playing
    playback.toggle()
    assert (playback.frame, playback.is_playing) == (start, True)


def test_play_elsewhere_continues() -> None:
    """Catches a play button that always restarts."""
    for is_looping, frame in ((True, 4), (False, 2)):
        playback = Playback(5, 10.0, is_playing=False, is_looping=is_looping)
        playback.seek(frame)
        playback.toggle()
        assert (playback.frame, playback.is_playing) == (frame, True)


@pytest.mark.parametrize("speed", [1.0, 0.3, -1.0, -2.5])
def test_the_next_frame_comes_after_the_predicted_time(speed: float) -> None:
    """Catches a wrong time until the next frame. The viewer would then skip a frame or redraw too early."""
    playback = Playback(5, 24.0, speed=speed)
    playback.seek(2)
    playback.advance(0.01)
    for _ in range(12):
        seconds, frame = playback.seconds_to_next_frame(), playback.frame
        assert 0 < seconds <= 1 / (24.0 * abs(speed)) + 1e-9
        playback.advance(0.9 * seconds)
        assert playback.frame == frame
        playback.advance(0.1 * seconds + 1e-6)
        assert playback.frame == (frame + playback.direction) % 5


@pytest.mark.parametrize(
    "playback",
    [Playback(5, 30.0, is_playing=False), Playback(5, 30.0, speed=0.0), Playback(1, 30.0)],
    ids=["paused", "speed 0", "one frame"],
)
def test_without_a_next_frame_the_time_is_infinite(playback: Playback) -> None:
    """Catches a division by a speed of 0, and a finite time until the next frame although the image does not change."""
    assert playback.seconds_to_next_frame() == math.inf
    playback.advance(1e3)
    assert playback.frame == 0


@pytest.mark.parametrize("is_looping", [True, False])
def test_a_single_frame_stays(is_looping: bool) -> None:
    """Catches a scene of one frame that pauses, wraps or divides by zero."""
    playback = Playback(1, 30.0, is_looping=is_looping)
    playback.advance(5.0)
    assert (playback.frame, playback.is_playing) == (0, True)
    playback.seek(3)
    assert playback.frame == 0
    playback.step(1)
    assert playback.frame == 0
    playback.toggle()
    assert (playback.frame, playback.is_playing) == (0, True)
