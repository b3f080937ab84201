"""Whole recorded captures: the files, the truth beside them, repeated commands, and refused command lines."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.cli.main import main
from fourd.recording.capture import open_capture, read_calibration
from fourd.recording.capture.split import read_test_views, write_test_views
from tests.captures import write_ball_capture

Array = NDArray[np.float64]
SMALL = ["--frames", "2", "--cameras", "3", "--size", "48"]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clean capture with masks and held-out views, which no test changes."""
    folder = write_ball_capture(tmp_path_factory.mktemp("clean") / "ball", cameras=4, frames=3, size=64)
    write_test_views(folder, ["02"])
    return folder


def _contents(path: Path) -> dict[str, bytes]:
    return {
        path_.relative_to(path).as_posix(): path_.read_bytes() for path_ in sorted(path.rglob("*")) if path_.is_file()
    }


def _pictures(folder: Path) -> Array:
    with open_capture(folder, mattes=False) as capture:
        cameras, frames = range(len(capture.names)), range(capture.frame_count)
        return np.array([[capture.image(camera, frame) for frame in frames] for camera in cameras], np.float64)


def test_a_given_capture_is_recorded_with_its_truth(clean: Path, tmp_path: Path) -> None:
    """Catches a changed source, a truth with errors, a capture without errors, and missing files."""
    before, out = _contents(clean), tmp_path / "out"
    assert main(["synth", str(out), "--rig", "--from", str(clean)]) == 0
    assert _contents(clean) == before
    truth = _contents(out / "truth" / "clean")
    assert {name: truth[name] for name in before if not name.startswith(".fourd")} == truth
    assert sorted(path.name for path in (out / "videos").iterdir()) == ["00.mp4", "01.mp4", "02.mp4", "03.mp4"]
    assert not (out / "masks").exists()
    assert not (out / "images").exists()
    assert read_test_views(out) == ("02",)
    given, true, recorded = (read_calibration(folder) for folder in (clean, out / "truth", out))
    for name, camera in given.items():
        assert np.allclose(true[name].rotation, camera.rotation, atol=1e-9)
        assert np.allclose(true[name].intrinsics, camera.intrinsics)
        assert 1e-5 < np.abs(recorded[name].rotation - camera.rotation).max() < 0.01
        assert 1e-3 < np.abs(recorded[name].intrinsics - camera.intrinsics).max() < 3
    difference = np.abs(_pictures(out) - _pictures(clean))
    assert difference.shape == (4, 3, 64, 64, 3)
    assert 1 < difference.mean() < 40
    rig = json.loads((out / "truth" / "rig.json").read_text())
    assert sorted(rig["cameras"]) == ["00", "01", "02", "03"]
    assert rig["settings"]["noise"] == 2.5
    masks = list((out / "truth" / "masks").rglob("*.png"))
    assert len(masks) == 12


def test_the_recorded_time_of_a_given_capture_is_a_blend(clean: Path, tmp_path: Path) -> None:
    """Catches an offset whose sign or unit differs from that of the truth."""
    out = tmp_path / "out"
    assert main(["synth", str(out), "--rig", "offset=0.5", "--from", str(clean)]) == 0
    rows = json.loads((out / "truth" / "rig.json").read_text())["cameras"]
    sharp, recorded = _pictures(clean), _pictures(out)
    for index, row in enumerate(rows.values()):
        offset = row["offset_ms"] * 30 / 1000
        other = sharp[index, 2 if offset > 0 else 0]
        blend = (1 - abs(offset)) * sharp[index, 1] + abs(offset) * other
        assert np.abs(recorded[index, 1] - blend).max() <= 0.51
    assert max(abs(row["offset_ms"]) for row in rows.values()) > 2


def test_repeated_commands_write_the_same_bytes(clean: Path, tmp_path: Path) -> None:
    """Catches random numbers that depend on threads, videos with a date inside, and a seed without effect."""
    for name, seed in (("a", "0"), ("b", "0"), ("c", "1")):
        assert main(["synth", str(tmp_path / name), "--rig", "--from", str(clean), "--seed", seed]) == 0
    first, second, other = (_contents(tmp_path / name) for name in "abc")
    assert first == second
    assert first.keys() == other.keys()
    drawn = ["extri.yml", "intri.yml", "truth/rig.json", "videos/00.mp4", "videos/03.mp4"]
    assert all(first[name] != other[name] for name in drawn)


def test_the_figure_is_recorded_with_masks_of_the_recorded_moment(tmp_path: Path) -> None:
    """Catches the true masks of the clean frame in place of those of the recorded one, and images that are compressed
    although video is off."""
    out = tmp_path / "out"
    assert main(["synth", str(out), "--rig", "offset=0.5,motion-blur=0.1", *SMALL, "--fps", "25"]) == 0
    assert main(["check", str(out / "truth" / "clean")]) == 0
    with open_capture(out / "truth" / "clean") as truth, open_capture(out) as recorded:
        assert recorded.fps == 25
        assert not recorded.has_masks
        assert recorded.image(0, 0).shape == (48, 48, 3)
        clean_mask = truth.mask(0, 1).astype(float)
    (out / "masks").symlink_to(out / "truth" / "masks")
    with open_capture(out) as recorded, open_capture(out / "truth" / "clean") as truth:
        assert np.abs(recorded.mask(0, 1) - clean_mask).max() > 40
        # Away from both masks, the studio does not change with time.
        still = (recorded.mask(0, 1) == 0) & (clean_mask == 0)
        assert np.abs(recorded.image(0, 1).astype(float) - truth.image(0, 1))[still].mean() < 3


def test_people_are_behind_the_subject(clean: Path, tmp_path: Path) -> None:
    """Catches people who cover the subject, and people whom no camera sees."""
    out = tmp_path / "out"
    assert main(["synth", str(out), "--rig", "people=9", "--from", str(clean)]) == 0
    difference = np.abs(_pictures(out) - _pictures(clean)).max(axis=-1)
    with open_capture(clean) as capture:
        masks = np.array([[capture.mask(camera, frame) for frame in range(3)] for camera in range(4)])
    assert difference[masks == 255].max() < 1
    assert (difference[masks == 0] > 20).mean() > 0.01


def test_a_repeated_command_is_finished_and_a_changed_source_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a capture that is made again for nothing, and one that is kept although its source has changed."""
    clean, out = write_ball_capture(tmp_path / "clean", cameras=3, frames=1, size=32), tmp_path / "out"
    words = ["synth", str(out), "--rig", "noise", "--from", str(clean)]
    assert main(words) == 0
    assert main(words) == 0
    assert "already finished with these settings" in capsys.readouterr().err
    first = next((clean / "images").rglob("*.png"))
    first.write_bytes((clean / "images" / "02" / first.name).read_bytes())
    assert main(words) == 0
    assert "made again (clean: " in capsys.readouterr().err
    assert main(["synth", str(out), "--rig", "noise=3,video", "--from", str(clean)]) == 0
    assert "made again (noise: 2.5 -> 3.0, video: 0.0 -> 23.0)" in capsys.readouterr().err
    assert not (out / "images").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--rig", "nois"), "--rig: expected factors among all, exposure, white-balance, "),
        (("--rig", "noise,,blur"), "got ''; correct the name"),
        (("--rig", "noise=x"), "--rig: noise: expected a number, got 'x'; write for example noise=2.5"),
        (("--rig", "noise=nan"), "--rig: noise: expected 0 to 50, got nan"),
        (("--rig", "offset=0.6"), "--rig: offset: expected 0 to 0.5, got 0.6"),
        (("--rig", "people=1.5"), "--rig: people: expected a whole number, got 1.5"),
        (("--rig", "noise,noise=3"), "--rig: noise: expected each factor once"),
        (("--rig", "noise", "--mbps", "3"), "--mbps: expected the factor video"),
        (("--rig", "video", "--mbps", "0"), "--mbps: expected 0.01 to 1000 Mbit/s, got 0"),
        (("--rig", "video", "--codec", "av1"), "--codec: expected one of 'h264', 'hevc', got 'av1'"),
        (("--codec", "hevc"), "--codec: expected the option --rig"),
        (("--from", "there"), "--from: expected the option --rig"),
        (("--rig", "--dome"), "--rig: expected no --dome, got both"),
        (("--rig", "--from", "nowhere"), "--from: nowhere: expected a capture's folder, got no such folder"),
        (("--rig", "--from", ".", "--size", "64"), "--size: expected no such option with --from"),
        (("--rig", "--size", "49"), "--rig: video: expected images with an even width and height, got 49 x 49"),
        (("--rig", "--seed", "-1"), "--seed: expected 0 to 9223372036854775807, got -1"),
    ],
)
def test_unusable_options_are_refused(
    words: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches options that are ignored without a word, and files that are written before the refusal."""
    assert main(["synth", str(tmp_path / "out"), *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("fourd synth: ")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_recorded_captures_and_captures_without_masks_are_refused(
    clean: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a capture that is disturbed twice, and people in front of a subject without masks."""
    out = tmp_path / "out"
    assert main(["synth", str(out), "--rig", "noise", "--from", str(clean)]) == 0
    capsys.readouterr()
    assert main(["synth", str(tmp_path / "twice"), "--rig", "--from", str(out)]) == 2
    assert "expected a clean capture, got one that fourd synth --rig wrote" in capsys.readouterr().err
    (out / "synth.json").unlink()
    assert main(["synth", str(tmp_path / "twice"), "--rig", "--from", str(out)]) == 2
    assert "--rig: people: expected a capture with masks" in capsys.readouterr().err
