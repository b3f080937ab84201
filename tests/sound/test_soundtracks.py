"""The choice of a soundtrack among those of videos, and its time in the capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.cli.main import main
from fourd.recording.capture import open_capture
from fourd.recording.capture.calibration import write_calibration
from fourd.recording.importing.record import sound_choice
from fourd.recording.soundtrack.captures import NAME, Span, cut_sound
from fourd.recording.soundtrack.choice import Recording, best_sound, choose_sound
from fourd.recording.soundtrack.clips import clip_sound
from fourd.recording.soundtrack.opus import Samples, decode_opus, encode_opus
from fourd.recording.soundtrack.reading import SoundLevel
from tests.importing.test_phone_videos import calibrations
from tests.sound.claps import clap, onsets
from tests.sync.soundtracks import write_video_with_sound

FPS = 10


def decoded(content: bytes | None) -> Samples:
    assert content is not None
    return np.concatenate(list(decode_opus(content)), axis=1)


def level(rms: float, rate: int = 48_000, clipped: float = 0.0) -> SoundLevel:
    return SoundLevel(rate, 2, rms, clipped)


def test_the_best_soundtrack_is_chosen() -> None:
    """Catches a choice of the loudest soundtrack although it is clipped, and of a telephone's narrow band."""
    levels = {"loud": level(0.4, clipped=0.01), "quiet": level(0.02), "good": level(0.1), "phone": level(0.2, 16_000)}
    assert best_sound(levels) == "good"
    assert best_sound({"loud": levels["loud"], "worse": level(0.5, clipped=0.1)}) == "loud"
    assert best_sound({"studio": level(0.1, 96_000), "louder": level(0.2)}) == "louder"
    assert best_sound({"silent": level(1e-6)}) is None
    assert best_sound({}) is None


def source(tmp_path: Path, sounds: dict[str, Samples | None], frames: int = 20) -> Path:
    """Three calibrated videos at 10 frames per second."""
    names = ["a", "b", "c"]
    write_calibration(tmp_path / "source", names, calibrations(32, 48))
    for name in names:
        write_video_with_sound(tmp_path / "source" / "videos" / f"{name}.mp4", frames, sounds.get(name))
    return tmp_path / "source"


def run_import(source: Path, out: Path, *words: str) -> int:
    return main(["import", "easymocap", str(source), str(out), *words])


def test_import_shifts_the_sound_to_the_clock_of_the_capture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a soundtrack that keeps the time of its video although the video is shifted by its offset."""
    folder = source(tmp_path, {"a": 0.1 * clap(2, 1.0)[0], "b": 0.9 * clap(2, 1.3)[0]})
    assert run_import(folder, tmp_path / "out", "--offset", "b=3") == 0
    assert "sound: b, 48 kHz, mono" in capsys.readouterr().err
    sound = decoded((tmp_path / "out" / NAME).read_bytes())
    assert onsets(sound) == pytest.approx([1.0], abs=0.003)
    assert sound.shape[1] == 17 * 4800
    assert run_import(folder, tmp_path / "out", "--offset", "b=3", "--sound", "a") == 0
    assert onsets(decoded((tmp_path / "out" / NAME).read_bytes()), 0.02) == pytest.approx([1.0], abs=0.003)
    assert run_import(folder, tmp_path / "out", "--offset", "b=3", "--sound", "none") == 0
    assert not (tmp_path / "out" / NAME).exists()
    assert sound_choice(tmp_path / "out") == "none"


def test_unpacked_captures_keep_the_sound(tmp_path: Path) -> None:
    """Catches sound that is lost with the videos."""
    folder = source(tmp_path, {"c": clap(2, 0.7)[0]})
    assert run_import(folder, tmp_path / "out", "--unpack") == 0
    with open_capture(tmp_path / "out", frames="5:15", mattes=False) as capture:
        sound = decoded(clip_sound(capture, "auto", None, print, untracked))
    assert onsets(sound) == pytest.approx([0.2], abs=0.003)
    assert sound.shape[1] == 48_000


@pytest.mark.parametrize(("frames", "begin", "seconds"), [("0:20", 0, 2), ("4:16", 0.4, 1.2), ("4:16:3", 0.4, 1.2)])
def test_the_selected_frames_cut_the_sound(frames: str, begin: float, seconds: float, tmp_path: Path) -> None:
    """Catches sound that starts with the capture instead of the first selected frame, or plays at another speed."""
    folder = source(tmp_path, {"a": clap(2, 1.0)[0]})
    with open_capture(folder, frames=frames, mattes=False) as capture:
        sound = decoded(clip_sound(capture, "auto", capture.fps, print, untracked))
    assert onsets(sound) == pytest.approx([1.0 - begin], abs=0.003)
    assert sound.shape[1] == pytest.approx(48_000 * seconds, abs=1)


def test_sound_is_left_out_with_a_line_if_the_speed_differs(tmp_path: Path) -> None:
    """Catches music at the speed of the recording under a scene in slow motion."""
    folder = source(tmp_path, {"a": clap(2, 1.0)[0]})
    lines: list[str] = []
    with open_capture(folder, mattes=False) as capture:
        assert clip_sound(capture, "auto", 5.0, lines.append, untracked) is None
    assert lines == ["the sound is left out, because the scene plays at 5 frames per second, not at 10"]


def test_a_soundtrack_that_cannot_be_read_is_left_out(tmp_path: Path) -> None:
    """Catches a capture that cannot be used because one of its optional soundtracks is damaged."""
    good = write_video_with_sound(tmp_path / "good.mp4", 5, 0.1 * clap(0.5, 0.2)[0])
    bad = tmp_path / "bad.mp4"
    bad.write_bytes(b"no video")
    recordings = {"bad": Recording(bad, 0.0), "good": Recording(good, 0.0)}
    lines: list[str] = []
    found = choose_sound("auto", recordings, 0.5, lines.append, untracked)
    assert found is not None
    assert found.note.startswith("sound: good")
    assert len(lines) == 1
    assert lines[0].startswith(f"the sound of bad is left out: {bad}: expected a soundtrack that can be decoded, got")
    with pytest.raises(UserError, match="choose another sound with --sound"):
        choose_sound("bad", recordings, 0.5, print, untracked)


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ("d", "expected auto, none, a file or a camera among a, b, c, got another name"),
        ("c", "expected a file with a soundtrack, got none"),
    ],
)
def test_mistakes_are_one_line(wanted: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a name that is silently ignored."""
    folder = source(tmp_path, {"a": clap(2, 1.0)[0]})
    assert run_import(folder, tmp_path / "out", "--sound", wanted) == 2
    assert words in capsys.readouterr().err.splitlines()[-1]


def test_music_of_another_file(tmp_path: Path) -> None:
    """Catches a file whose beginning is not at frame 0, for example because the frames are cut."""
    folder = source(tmp_path, {})
    music = tmp_path / "music.ogg"
    music.write_bytes(encode_opus([clap(3, 1.5, channels=2)], 2))
    assert run_import(folder, tmp_path / "out", "--sound", str(music)) == 0
    assert onsets(decoded((tmp_path / "out" / NAME).read_bytes())) == pytest.approx([1.5], abs=0.003)
    with open_capture(folder, frames="10:20", mattes=False) as capture:
        sound = decoded(clip_sound(capture, str(music), None, print, untracked))
    assert onsets(sound) == pytest.approx([0.5], abs=0.003)


def test_a_damaged_file_of_the_capture_is_named(tmp_path: Path) -> None:
    """Catches a damaged sound.ogg that is silently replaced by a soundtrack of the videos."""
    folder = source(tmp_path, {"a": clap(2, 1.0)[0]})
    (folder / NAME).write_bytes(encode_opus([clap(2, 1.0)], 1)[:500])
    with (
        open_capture(folder, mattes=False) as capture,
        pytest.raises(UserError, match=r"sound\.ogg: expected a complete"),
    ):
        clip_sound(capture, "auto", None, print, untracked)


def test_the_whole_sound_is_not_encoded_again() -> None:
    """Catches a loss of quality with every edit and every bake."""
    content = encode_opus([clap(2, 1.0)], 1)
    assert cut_sound(content, Span(0, 2)) is content
    assert cut_sound(content, Span(0, 1.5)) != content
