"""Time offsets from soundtracks with known offsets, noise, echoes and different levels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import resample_poly

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.recording.capture import open_capture, write_calibration
from fourd.recording.importing.importer import ImportOptions
from fourd.recording.sync.sound import Soundtrack, estimate_sound_offsets, read_soundtrack, travel_times
from tests.capture.numbered_videos import number_of
from tests.importing.test_importer import NAMES, run_import
from tests.importing.test_phone_videos import calibrations
from tests.sync.soundtracks import RATE, Samples, recorded, room_sound, write_video_with_sound

STARTS = (1.0, 1.7531, 0.5883, 1.0123)
LEVELS = (0.3, 0.03, 0.8, 0.1)


def recordings(seconds: float, rng: np.random.Generator) -> list[Samples]:
    sound = room_sound(seconds + 3, rng)
    return [recorded(sound, start, seconds, level, rng) for start, level in zip(STARTS, LEVELS, strict=True)]


def reduced(samples: Samples) -> Soundtrack:
    """A soundtrack at 8 kHz."""
    return Soundtrack(resample_poly(samples, 1, 6).astype(np.float32), 0.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("codec", ["aac", "pcm_s16le"])
def test_offsets_are_within_two_milliseconds(seed: int, codec: str, tmp_path: Path) -> None:
    """Catches an offset of the wrong sign, an offset that contains the encoder's delay, and an echo that is mistaken
    for the sound. Each soundtrack has noise at 20 dB SNR, two echoes and its own level."""
    rng = np.random.default_rng(seed)
    soundtracks = []
    for index, samples in enumerate(recordings(4, rng)):
        path = tmp_path / f"{index}.{'mp4' if codec == 'aac' else 'mov'}"
        found = read_soundtrack(write_video_with_sound(path, 3, samples, codec=codec), 0.0)
        assert found is not None
        soundtracks.append(found)
    offsets = estimate_sound_offsets(soundtracks)
    expected = np.array([STARTS[0] - start for start in STARTS])
    assert np.abs(np.array(offsets.seconds) - expected).max() < 0.002
    assert min(offsets.confidence) > 0.9


@pytest.mark.parametrize("seed", range(5))
def test_other_sounds_have_no_confidence(seed: int) -> None:
    """Catches a high confidence for the offset between recordings of different events."""
    rng = np.random.default_rng(seed)
    soundtracks = [reduced(recorded(room_sound(4, rng), 0, 3, 0.3, rng)) for _ in range(3)]
    assert max(estimate_sound_offsets(soundtracks).confidence) < 0.3


def test_one_foreign_recording_does_not_disturb_the_others(rng: np.random.Generator) -> None:
    """Catches a soundtrack of another event that changes the offsets of the other soundtracks."""
    soundtracks = [reduced(samples) for samples in recordings(4, rng)]
    soundtracks[1] = reduced(recorded(room_sound(4, rng), 0, 3, 0.3, rng))
    offsets = estimate_sound_offsets(soundtracks)
    assert offsets.confidence[1] < 0.3
    assert min(offsets.confidence[index] for index in (0, 2, 3)) > 0.5
    assert abs(offsets.seconds[2] - (STARTS[0] - STARTS[2])) < 0.002


def test_sound_that_starts_late_has_its_own_time(rng: np.random.Generator) -> None:
    """Catches a soundtrack whose start after the first frame of the video is ignored."""
    samples = reduced(recordings(4, rng)[0]).samples
    offsets = estimate_sound_offsets([Soundtrack(samples, 0.0), Soundtrack(samples[800:], 0.1 + 0.25)])
    assert offsets.seconds[1] == pytest.approx(0.25, abs=1e-4)


def test_travel_times() -> None:
    """Catches a wrong speed of sound. Sound needs 29 ms for 10 m."""
    assert travel_times({"a": np.array([10.0, 0, 0])}, np.zeros(3))["a"] == pytest.approx(0.02915, abs=1e-5)


def write_source(folder: Path, sounds: dict[str, Samples | None], first: dict[str, int] | None = None) -> Path:
    """Write three calibrated videos with the given soundtracks. Each video has 20 frames at 10 frames per second."""
    write_calibration(folder, NAMES, calibrations(32, 48))
    for name in NAMES:
        path = folder / "videos" / f"{name}.mp4"
        write_video_with_sound(path, 20, sounds.get(name), first=(first or {}).get(name, 10))
    return folder


def synchronised(rng: np.random.Generator) -> tuple[dict[str, Samples | None], dict[str, int]]:
    """Soundtracks and first frame numbers of three cameras; b starts 0.43 s late and c 0.4 s early."""
    sound = room_sound(5, rng)
    starts = {"a": 1.0, "b": 1.43, "c": 0.6}
    sounds = {name: recorded(sound, start, 2, 0.3, rng) for name, start in starts.items()}
    return dict(sounds), {"a": 10, "b": 14, "c": 6}


@pytest.mark.parametrize("apply", [False, True])
def test_import_synchronises_by_sound(apply: bool, tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches offsets from sound that are not applied, or applied with the wrong sign."""
    source = write_source(tmp_path / "source", *synchronised(rng))
    lines = run_import(source, tmp_path / "out", sync=not apply, apply_sync=apply)
    end = ", applied" if apply else ""
    assert f"b: -4 frames (-430.0 ms by sound), confidence 100%{end}" in lines
    assert f"c: +4 frames (+400.0 ms by sound), confidence 100%{end}" in lines
    assert any("sound needs 29 ms for 10 m" in line for line in lines)
    capture = open_capture(tmp_path / "out")
    shown = {tuple(number_of(capture.image(camera, frame)) - frame for camera in range(3)) for frame in range(5)}
    assert shown == ({(14, 14, 14)} if apply else {(10, 14, 6)})


def test_the_travel_time_of_sound_is_corrected(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a correction of the travel time with the wrong sign."""
    source = write_source(tmp_path / "source", *synchronised(rng))
    centre = calibrations(32, 48)[1].centre
    far = calibrations(32, 48)[0].centre - centre
    place = tuple(float(value) for value in centre + far * (1 + 34.3 / np.linalg.norm(far)))
    lines = run_import(source, tmp_path / "out", sync=True, sound_at=place)
    distance = np.linalg.norm(far)
    assert any(line.startswith("the travel time of sound from (") and f"({'b'})" in line for line in lines)
    late = 1e3 * distance / 343
    assert any(line.startswith(f"b: -4 frames ({-430 - late:+.1f} ms by sound)") for line in lines)


def test_unusable_soundtracks_are_reported(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches offsets from soundtracks that are missing, silent or of another event, and such soundtracks that are
    skipped without a message."""
    good = synchronised(rng)[0]
    foreign = recorded(room_sound(3, rng), 0.5, 2, 0.3, rng)
    cases: dict[str, tuple[Samples | None, str]] = {
        "missing": (None, "b.mp4: expected a video with a soundtrack, got no soundtrack; use --sync-by motion"),
        "silent": (np.zeros(2 * RATE, np.float32), "b.mp4: expected a soundtrack with sound, got silence in b; switch"),
        "foreign": (foreign, "b.mp4: expected sound that all cameras record, got nothing in common in b (best match"),
    }
    for case, (samples, message) in cases.items():
        source = write_source(tmp_path / case, good | {"b": samples})
        words = ["import", str(source), str(tmp_path / f"out-{case}"), "--centres", "as-given"]
        assert main([*words, "--apply-sync", "--sync-by", "sound"]) == 2
        error = capsys.readouterr().err.strip().replace("\n", " ")
        assert message in error
    lines = run_import(tmp_path / "silent", tmp_path / "auto", sync=True)
    assert any(
        line.startswith("offsets are estimated from motion, because sound gives no offsets") and "silence in b" in line
        for line in lines
    )


def test_options_need_each_other(tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches options for sound that are ignored without --sync."""
    assert ImportOptions().sync_by == "auto"
    source = write_source(tmp_path / "source", {})
    with pytest.raises(UserError, match="--sync-by, --sound-at: expected --sync or --apply-sync"):
        run_import(source, tmp_path / "out", sync_by="sound")
    assert main(["import", str(source), str(tmp_path / "out"), "--sync", "--sound-at", "1,2"]) == 2
    assert "--sound-at: expected auto, none, centre or X,Y,Z in metres, got '1,2'" in capsys.readouterr().err
