"""Tests of the import: links to files, frames that are aligned in time, and no overwritten files."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.processes.isolation import ParserProcess
from fourd.base.progress import untracked
from fourd.recording.calibration.scale import Distance
from fourd.recording.capture import open_capture, write_calibration
from fourd.recording.capture.video import VideoIndex, index_video
from fourd.recording.importing.detection import pick_format
from fourd.recording.importing.importer import ImportOptions, import_source
from tests.capture.numbered_videos import HEIGHT, WIDTH, number_of, write_numbered_video
from tests.captures import ring_cameras
from tests.sync.discs import write_disc_videos

NAMES = ("a", "b", "c")


def write_source(folder: Path, numbers: dict[str, Iterable[int]] | None = None) -> Path:
    """Write three videos in EasyMocap's layout."""
    cameras = [replace(camera, height=HEIGHT) for camera in ring_cameras(3, WIDTH)]
    write_calibration(folder, NAMES, cameras)
    for name in NAMES:
        write_numbered_video(folder / "videos" / f"{name}.mp4", tuple((numbers or {}).get(name, range(40))))
    return folder


def run_import(source: Path, out: Path, **options: object) -> list[str]:
    """Import a source. Returns all log lines, where warnings have a prefix."""
    lines: list[str] = []
    settings = ImportOptions(**{"centres": "as-given"} | options)
    import_source(
        pick_format(None, source),
        source,
        out,
        settings,
        log=lines.append,
        warn=lambda line: lines.append(f"warning: {line}"),
        track=untracked,
    )
    return lines


def contents(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(path.relative_to(folder)): (path.lstat().st_mtime_ns, path.read_bytes())
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_videos_and_unpacked_frames_agree(tmp_path: Path) -> None:
    """Catches a frame number that differs by one between a linked video and its unpacked frames."""
    source = write_source(tmp_path / "source")
    run_import(source, tmp_path / "linked")
    run_import(source, tmp_path / "unpacked", unpack=True)
    linked, unpacked = open_capture(tmp_path / "linked"), open_capture(tmp_path / "unpacked")
    assert not (tmp_path / "linked" / "images").exists()
    assert not (tmp_path / "unpacked" / "videos").exists()
    assert linked.frame_count == unpacked.frame_count == 40
    for camera in range(3):
        for frame in (0, 1, 17, 39, 20):
            ours, theirs = linked.image(camera, frame), unpacked.image(camera, frame)
            assert number_of(ours) == number_of(theirs) == frame
            assert np.abs(ours.astype(int) - theirs).mean() < 3


def test_names_with_other_characters(tmp_path: Path) -> None:
    """Catches names that the calibration's writer refuses after all other work, and names that are changed."""
    names = ["IMG 0001 (1)", "cam.1", "左", "C#1: [x]", "1e5", "true", "100%3A"]
    cameras = [replace(camera, height=HEIGHT) for camera in ring_cameras(len(names), WIDTH)]
    write_calibration(tmp_path / "source", names, cameras)
    picture = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for name in names:
        for folder in ("images", "masks"):
            (tmp_path / "source" / folder / name).mkdir(parents=True)
            assert cv2.imwrite(str(tmp_path / "source" / folder / name / "000000.png"), picture)
    run_import(tmp_path / "source", tmp_path / "out")
    capture = open_capture(tmp_path / "out")
    assert sorted(capture.names) == sorted(names)
    for name, camera in zip(names, cameras, strict=True):
        assert np.array_equal(capture.cameras[capture.names.index(name)].translation, camera.translation)
    (tmp_path / "source" / "images" / "true").rename(tmp_path / "source" / "images" / "-true")
    with pytest.raises(UserError, match="camera '-true': expected no dot and no dash at the start of the name; rename"):
        run_import(tmp_path / "source", tmp_path / "other")


def test_equal_calibrations_are_named(tmp_path: Path) -> None:
    """Catches a calibration that was copied to a second camera, which the import accepts without a word."""
    first, second, third = (replace(camera, height=HEIGHT) for camera in ring_cameras(3, WIDTH))
    source = write_source(tmp_path / "source")
    rest = "so at most one of them is right; calibrate these cameras again, or leave all but one out"
    near = replace(first, translation=first.translation + 1e-7)
    turned = replace(third, translation=third.rotation @ first.rotation.T @ first.translation)
    far = replace(first, translation=first.translation + 1e-3)
    for third_camera, line in (
        (first, f"warning: cameras 'a' and 'c' have equal calibrations, {rest}"),
        (near, f"warning: cameras 'a' and 'c' have equal calibrations, {rest}"),
        (turned, f"warning: cameras 'a' and 'c' have equal positions, {rest}"),
        (far, None),
        (third, None),
    ):
        write_calibration(source, NAMES, [first, second, third_camera])
        lines = [each for each in run_import(source, tmp_path / "out") if "have equal" in each]
        assert lines == ([] if line is None else [line])


def test_files_are_linked_or_copied(tmp_path: Path) -> None:
    """Catches videos that are copied without --copy, and a copied video that is still a link to the source."""
    source = write_source(tmp_path / "source")
    run_import(source, tmp_path / "linked")
    run_import(source, tmp_path / "copied", copy=True)
    assert (tmp_path / "linked" / "videos" / "a.mp4").is_symlink()
    copied = tmp_path / "copied" / "videos" / "a.mp4"
    assert not copied.is_symlink()
    run_import(source, tmp_path / "linked", copy=True)
    assert not (tmp_path / "linked" / "videos" / "a.mp4").is_symlink()
    assert copied.read_bytes() == (source / "videos" / "a.mp4").read_bytes()


@pytest.mark.parametrize("unpack", [False, True])
def test_offsets_synchronise_cameras(unpack: bool, tmp_path: Path) -> None:
    """Catches offsets that are applied with the wrong sign."""
    source = write_source(tmp_path / "source", {"b": range(3, 40), "c": range(1, 39)})
    lines = run_import(source, tmp_path / "out", offsets={"b": -3, "c": -1}, unpack=unpack)
    capture = open_capture(tmp_path / "out")
    assert capture.frame_count == 36
    for frame in (0, 5, 35):
        assert {number_of(capture.image(camera, frame)) for camera in range(3)} == {frame + 3}
    assert "a: its first 3 frames are skipped because of the offsets" in lines


def test_different_frame_counts_are_noted(tmp_path: Path) -> None:
    """Catches frames that are dropped without a log line."""
    lines = run_import(write_source(tmp_path / "source", {"b": range(37)}), tmp_path / "out")
    assert "a: the last 3 frames are not used: other videos end earlier" in lines
    assert open_capture(tmp_path / "out").frame_count == 37


def test_different_frame_rates_without_an_import_are_refused(tmp_path: Path) -> None:
    """Catches cameras with different frame rates that are read by frame numbers, so that they drift apart."""
    source = write_source(tmp_path / "source")
    write_numbered_video(source / "videos" / "b.mp4", fps=25)
    with pytest.raises(UserError, match=r"expected 25 frames per second, .* got 30; .* with: fourd import"):
        open_capture(source)


def test_offset_past_the_end_is_refused(tmp_path: Path) -> None:
    """Catches an offset past the end of a video, which would give a capture without frames."""
    source = write_source(tmp_path / "source")
    with pytest.raises(
        UserError, match=r"b.mp4: expected a video that overlaps in time .*, got 1.33 s that end before .*--offset of"
    ):
        run_import(source, tmp_path / "out", offsets={"b": 40})


def test_second_import_changes_nothing(tmp_path: Path) -> None:
    """Catches links that are created again without need, and a manually edited calibration that is overwritten."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    run_import(source, out)
    (out / "intri.yml").write_text((out / "intri.yml").read_text() + "\n# mine\n")
    before = contents(out)
    (out / "videos" / "b.mp4").unlink()
    assert "the import with these options already exists; no file is changed" in run_import(source, out)
    after = contents(out)
    assert after.keys() == before.keys()
    assert {name: content for name, (_, content) in after.items()} == {n: content for n, (_, content) in before.items()}
    assert after["intri.yml"] == before["intri.yml"]
    assert after["videos/a.mp4"] == before["videos/a.mp4"]


def test_videos_are_read_through_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches videos that one import indexes twice, or that are indexed again after an interruption."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    indexed: list[str] = []

    def counted(path: Path, parser: ParserProcess | None = None) -> VideoIndex:
        if len(indexed) == 2 and not out.joinpath("stopped").exists():
            out.joinpath("stopped").touch()
            raise KeyboardInterrupt
        indexed.append(path.stem)
        return index_video(path)

    monkeypatch.setattr("fourd.recording.capture.video_list.index_video", counted)
    with pytest.raises(KeyboardInterrupt):
        run_import(source, out, sync=True)
    run_import(source, out, sync=True)
    run_import(source, out, unpack=True)
    run_import(source, out)
    assert indexed == list(NAMES)


def test_temporary_files_of_a_killed_import_are_removed(tmp_path: Path) -> None:
    """Catches an import that refuses the folder of an interrupted import, and partial copies of files that are never
    removed."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    (out / ".fourd").mkdir(parents=True)
    (out / ".fourd" / ".unfinished-import-abc.json").write_text("{")
    run_import(source, out, copy=True)
    (out / "videos" / ".unfinished-b-abc.mp4").write_bytes(b"half")
    run_import(source, out, copy=True)
    assert not [path for path in out.rglob("*") if "unfinished" in path.name]
    assert sorted(path.name for path in (out / "videos").iterdir()) == ["a.mp4", "b.mp4", "c.mp4"]


def test_changed_calibration_is_applied(tmp_path: Path) -> None:
    """Catches an import that ignores a new calibration of the source."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    run_import(source, out)
    moved = [replace(camera, height=HEIGHT, translation=camera.translation + 1) for camera in ring_cameras(3, WIDTH)]
    write_calibration(source, NAMES, moved)
    run_import(source, out)
    assert np.allclose(open_capture(out).cameras[0].translation, moved[0].translation)


def test_the_unit_is_that_of_the_source_or_of_a_measurement(tmp_path: Path) -> None:
    """Catches lengths without a unit although the source states it, a unit that a measured distance has replaced, and
    an import that ignores that the source states its unit since the last one."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    run_import(source, out)
    assert open_capture(out).metres_per_unit is None
    write_calibration(source, NAMES, [replace(each, height=HEIGHT) for each in ring_cameras(3, WIDTH)], 0.001)
    run_import(source, out)
    assert open_capture(out).metres_per_unit == 0.001
    run_import(source, tmp_path / "measured", distance=Distance("a", "b", 2.0))
    assert open_capture(tmp_path / "measured").metres_per_unit == 1


def test_other_folders_are_not_overwritten(tmp_path: Path, ball_capture: Path) -> None:
    """Catches an import that overwrites the calibration of another capture."""
    source = write_source(tmp_path / "source")
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "intri.yml").write_text("mine")
    with pytest.raises(
        UserError, match="expected a new folder or the folder of an import, got a folder with other files"
    ):
        run_import(source, other)
    assert contents(other).keys() == {"intri.yml"}
    run_import(source, tmp_path / "out")
    with pytest.raises(UserError, match="expected a new folder or an import of"):
        run_import(ball_capture, tmp_path / "out")


def test_unpacked_frames_keep_their_offsets(tmp_path: Path) -> None:
    """Catches a folder that mixes unpacked frames with different time offsets."""
    source = write_source(tmp_path / "source")
    run_import(source, tmp_path / "out", unpack=True)
    with pytest.raises(UserError, match=r"expected the offsets of the frames in this folder \(none\), got b=2"):
        run_import(source, tmp_path / "out", unpack=True, offsets={"b": 2})
    write_numbered_video(source / "videos" / "b.mp4", range(41))
    with pytest.raises(UserError, match="expected the videos unpacked into this folder, got other videos"):
        run_import(source, tmp_path / "out", unpack=True)


def test_damaged_record_is_reported(tmp_path: Path) -> None:
    """Catches a damaged record that is ignored or causes a traceback."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    run_import(source, out)
    record = out / ".fourd" / "import.json"
    for text in ("{", "[]", json.dumps({"version": 9}), json.dumps({"version": 1, "warnings": []})):
        record.write_text(text)
        with pytest.raises(UserError, match="expected the record of an import"):
            run_import(source, out)


def test_easymocap_round_trip(ball_capture: Path, tmp_path: Path) -> None:
    """Catches pixels or poses that change although no conversion is needed."""
    run_import(ball_capture, tmp_path / "out")
    before, after = open_capture(ball_capture), open_capture(tmp_path / "out")
    assert before.names == after.names
    for index, (theirs, ours) in enumerate(zip(before.cameras, after.cameras, strict=True)):
        assert np.allclose(theirs.intrinsics, ours.intrinsics, atol=1e-9)
        assert np.allclose(theirs.rotation, ours.rotation, atol=1e-9)
        assert np.allclose(theirs.translation, ours.translation, atol=1e-9)
        assert (theirs.width, theirs.height) == (ours.width, ours.height)
        for frame in range(before.frame_count):
            assert np.array_equal(before.image(index, frame), after.image(index, frame))
            assert np.array_equal(before.mask(index, frame), after.mask(index, frame))


def test_estimated_offsets_are_applied_on_request(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches an estimated offset of the wrong sign, and an option --sync that applies the estimate."""
    source = write_disc_videos(tmp_path / "source", NAMES, (0, -9, 0), 84, rng)
    lines = run_import(source, tmp_path / "estimated", sync=True)
    assert any(line.startswith("b: -9 frames") for line in lines)
    assert (tmp_path / "estimated" / ".fourd" / "sync.png").is_file()
    assert open_capture(tmp_path / "estimated").frame_count == 84
    lines = run_import(source, tmp_path / "out", apply_sync=True)
    assert any(line.startswith("b: -9 frames") and "applied" in line for line in lines)
    with open_capture(tmp_path / "estimated") as before, open_capture(tmp_path / "out") as after:
        assert after.frame_count == 75
        for camera, skipped in enumerate((9, 0, 9)):
            assert np.array_equal(after.image(camera, 0), before.image(camera, skipped))
