"""The sound of rendered videos."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from fourd.cli.main import main
from fourd.recording.soundtrack.captures import Span
from fourd.viewer.output.sound import parts_at_speed
from tests.sound.claps import onsets, write_clap_scene

CLAP = 20 / 30


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of 2 s with a clap at 0.667 s. Tests must not change it."""
    return write_clap_scene(tmp_path_factory.mktemp("clap") / "clap.4dv", points=200)


def sound_of(path: Path) -> tuple[str, list[float], float] | None:
    """The codec of a video's sound, the times of its claps, and its duration in seconds, on the clock of the images."""
    with av.open(str(path)) as container:
        if not container.streams.audio:
            return None
        stream = container.streams.audio[0]
        blocks, start = [], None
        for frame in container.decode(stream):
            start = frame.time if start is None else start
            blocks.append(frame.to_ndarray())
        samples = np.concatenate(blocks, axis=1)
    first = start or 0.0
    return stream.codec_context.name, [first + time for time in onsets(samples)], samples.shape[1] / 48_000


def flashes(path: Path) -> list[float]:
    """The times at which the images of a video become bright."""
    with av.open(str(path)) as container:
        frames = [(frame.time, frame.to_ndarray(format="gray").mean()) for frame in container.decode(video=0)]
    light = np.array([value for _, value in frames])
    bright = light > (light.min() + light.max()) / 2
    return [float(frames[index][0] or 0) for index in range(len(frames)) if bright[index] and not bright[index - 1]]


def render(scene: Path, out: Path, *words: str) -> int:
    return main(["render", str(scene), "--out", str(out), "--size", "64", "64", *words])


@pytest.mark.parametrize(
    ("name", "words", "codec"),
    [
        ("a.mp4", ["--path", "orbit", "--steps", "130"], "aac"),
        ("a.webm", ["--path", "orbit", "--steps", "70"], "opus"),
        ("a.mp4", ["--views", "00"], "aac"),
        ("a.mp4", ["--views", "00", "--frames", "20:60"], "aac"),
        ("a.mp4", ["--path", "orbit", "--frames", "10:60:2", "--steps", "60"], "aac"),
    ],
)
def test_the_clap_is_heard_when_it_is_seen(
    scene: Path, tmp_path: Path, name: str, words: list[str], codec: str
) -> None:
    """Catches sound that is off by the delay of its encoder, by the first frame, or after the loop of the scene."""
    assert render(scene, tmp_path / name, *words) == 0
    found, seen = sound_of(tmp_path / name), flashes(tmp_path / name)
    assert found is not None
    assert found[0] == codec
    assert len(seen) >= 1
    assert found[1] == pytest.approx(seen, abs=0.034)
    with av.open(str(tmp_path / name)) as container:
        images = sum(1 for _ in container.decode(video=0)) / float(container.streams.video[0].average_rate or 30)
    assert found[2] == pytest.approx(images, abs=0.05)


@pytest.mark.parametrize("words", [["--path", "orbit", "--fps", "12"], ["--views", "00,01"]])
def test_sound_is_left_out_with_a_line(
    scene: Path, tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches music at full speed under a scene in slow motion."""
    assert render(scene, tmp_path / "a.mp4", *words) == 0
    assert sound_of(tmp_path / "a.mp4") is None
    expected = "the sound is left out, because the scene does not play at its own speed in this video"
    assert capsys.readouterr().err.count(expected) == 1


def test_videos_without_a_window_have_sound(scene: Path, tmp_path: Path) -> None:
    """Catches a second way to render videos that forgets the sound."""
    out = tmp_path / "a.mp4"
    assert main(["view", str(scene), "--headless", str(out), "--size", "64", "64", "--renderer", "cpu"]) == 0
    found = sound_of(out)
    assert found is not None
    assert found[1] == pytest.approx([CLAP, CLAP + 2], abs=0.034)


def test_a_gif_has_no_sound(scene: Path, tmp_path: Path) -> None:
    """Catches an encoder of sound that is opened for a file without sound."""
    assert render(scene, tmp_path / "a.gif", "--views", "00", "--frames", "10:16") == 0
    assert sound_of(tmp_path / "a.gif") is None


@pytest.mark.parametrize(
    ("frames", "fps", "expected"),
    [
        (range(4), 30, [Span(0, 4 / 30)]),
        ([2, 3, 0, 1, 2], 30, [Span(2 / 30, 2 / 30), Span(0, 3 / 30)]),
        ([0, 0, 1, 1, 2, 2], 60, [Span(0, 0.1)]),
        ([0, 2, 4], 15, [Span(0, 0.2)]),
        ([3, 2, 1, 0], 30, None),
        ([0] * 9, 30, None),
        ([0, 0, 1, 1, 2, 2], 30, None),
        ([0, 2, 4, 6], 30, None),
        ([], 30, None),
    ],
)
def test_parts_at_speed(frames: list[int], fps: float, expected: list[Span] | None) -> None:
    """Catches sound for a scene that is frozen, slow, fast or reversed, and none for one that is only repeated."""
    found = parts_at_speed(list(frames), fps, 30.0)
    assert (None if found is None else list(found)) == (None if expected is None else expected)
