"""What an import writes: links, frames in time, and nothing over somebody else's files."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.capture import open_capture, write_calibration
from fourd.capture.video import VideoIndex, index_video
from fourd.errors import UserError
from fourd.importing.importer import ImportOptions, import_source, pick_format
from fourd.progress import untracked
from tests.capture.films import HEIGHT, WIDTH, number_of, write_film
from tests.captures import ring_cameras

NAMES = ("a", "b", "c")


def write_source(folder: Path, numbers: dict[str, Iterable[int]] | None = None) -> Path:
    """Three videos in EasyMocap's layout."""
    cameras = [replace(camera, height=HEIGHT) for camera in ring_cameras(3, WIDTH)]
    write_calibration(folder, NAMES, cameras)
    for name in NAMES:
        write_film(folder / "videos" / f"{name}.mp4", tuple((numbers or {}).get(name, range(40))))
    return folder


def bring(source: Path, out: Path, **options: object) -> list[str]:
    """Import, and all that was said; warnings begin so."""
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


def test_a_capture_of_videos_is_the_unpacked_one(tmp_path: Path) -> None:
    """Catches frames that are off by one between the two ways to read them."""
    source = write_source(tmp_path / "source")
    bring(source, tmp_path / "linked")
    bring(source, tmp_path / "unpacked", unpack=True)
    linked, unpacked = open_capture(tmp_path / "linked"), open_capture(tmp_path / "unpacked")
    assert not (tmp_path / "linked" / "images").exists()
    assert not (tmp_path / "unpacked" / "videos").exists()
    assert linked.frame_count == unpacked.frame_count == 40
    for camera in range(3):
        for frame in (0, 1, 17, 39, 20):
            ours, theirs = linked.image(camera, frame), unpacked.image(camera, frame)
            assert number_of(ours) == number_of(theirs) == frame
            assert np.abs(ours.astype(int) - theirs).mean() < 3


def test_files_are_linked_or_copied(tmp_path: Path) -> None:
    """Catches gigabytes that are copied unasked, and a copy that needs its source."""
    source = write_source(tmp_path / "source")
    bring(source, tmp_path / "linked")
    bring(source, tmp_path / "copied", copy=True)
    assert (tmp_path / "linked" / "videos" / "a.mp4").is_symlink()
    copied = tmp_path / "copied" / "videos" / "a.mp4"
    assert not copied.is_symlink()
    bring(source, tmp_path / "linked", copy=True)
    assert not (tmp_path / "linked" / "videos" / "a.mp4").is_symlink()
    assert copied.read_bytes() == (source / "videos" / "a.mp4").read_bytes()


@pytest.mark.parametrize("unpack", [False, True])
def test_offsets_bring_cameras_into_time(unpack: bool, tmp_path: Path) -> None:
    """Catches an offset applied the wrong way round."""
    source = write_source(tmp_path / "source", {"b": range(3, 40), "c": range(1, 39)})
    lines = bring(source, tmp_path / "out", offsets={"b": -3, "c": -1}, unpack=unpack)
    capture = open_capture(tmp_path / "out")
    assert capture.frame_count == 36
    for frame in (0, 5, 35):
        assert {number_of(capture.image(camera, frame)) for camera in range(3)} == {frame + 3}
    assert "a: its first 3 frames are skipped, as the offsets say" in lines


def test_counts_that_differ_are_said(tmp_path: Path) -> None:
    """Catches frames that vanish without a word."""
    lines = bring(write_source(tmp_path / "source", {"b": range(37)}), tmp_path / "out")
    assert "a: the last 3 frames are not used, others end before" in lines
    assert open_capture(tmp_path / "out").frame_count == 37


def test_rates_that_differ_are_refused(tmp_path: Path) -> None:
    """Catches cameras that drift apart."""
    source = write_source(tmp_path / "source")
    write_film(source / "videos" / "b.mp4", fps=25)
    with pytest.raises(UserError, match=r"b.mp4: expected 30 frames per second, as a has, got 25"):
        bring(source, tmp_path / "out")


def test_an_offset_past_the_end_is_refused(tmp_path: Path) -> None:
    """Catches a capture without frames."""
    source = write_source(tmp_path / "source")
    with pytest.raises(UserError, match="expected"):
        bring(source, tmp_path / "out", offsets={"b": 40})


def test_the_second_import_changes_nothing(tmp_path: Path) -> None:
    """Catches links made anew, and a calibration mended by hand that is overwritten."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    bring(source, out)
    (out / "intri.yml").write_text((out / "intri.yml").read_text() + "\n# mine\n")
    before = contents(out)
    (out / "videos" / "b.mp4").unlink()
    assert "done already with these options; nothing to change" in bring(source, out)
    after = contents(out)
    assert after.keys() == before.keys()
    assert {name: content for name, (_, content) in after.items()} == {n: content for n, (_, content) in before.items()}
    assert after["intri.yml"] == before["intri.yml"]
    assert after["videos/a.mp4"] == before["videos/a.mp4"]


def test_a_video_is_read_through_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches an import that reads whole videos twice, and one that reads them again after it was stopped."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    indexed: list[str] = []

    def counted(path: Path) -> VideoIndex:
        if len(indexed) == 2 and not out.joinpath("stopped").exists():
            out.joinpath("stopped").touch()
            raise KeyboardInterrupt
        indexed.append(path.stem)
        return index_video(path)

    monkeypatch.setattr("fourd.capture.video_list.index_video", counted)
    with pytest.raises(KeyboardInterrupt):
        bring(source, out, sync=True)
    bring(source, out, sync=True)
    bring(source, out, unpack=True)
    bring(source, out)
    assert indexed == list(NAMES)


def test_what_a_killed_import_left_half_written_is_removed(tmp_path: Path) -> None:
    """Catches a folder refused since its record itself was being written, and half copies that stay for ever."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    (out / ".fourd").mkdir(parents=True)
    (out / ".fourd" / ".unfinished-import-abc.json").write_text("{")
    bring(source, out, copy=True)
    (out / "videos" / ".unfinished-b-abc.mp4").write_bytes(b"half")
    bring(source, out, copy=True)
    assert not [path for path in out.rglob("*") if "unfinished" in path.name]
    assert sorted(path.name for path in (out / "videos").iterdir()) == ["a.mp4", "b.mp4", "c.mp4"]


def test_another_calibration_is_taken_over(tmp_path: Path) -> None:
    """Catches a no-op where the source was calibrated again."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    bring(source, out)
    moved = [replace(camera, height=HEIGHT, translation=camera.translation + 1) for camera in ring_cameras(3, WIDTH)]
    write_calibration(source, NAMES, moved)
    bring(source, out)
    assert np.allclose(open_capture(out).cameras[0].translation, moved[0].translation)


def test_somebody_s_folder_is_left_alone(tmp_path: Path, ball_capture: Path) -> None:
    """Catches a calibration written over another capture's."""
    source = write_source(tmp_path / "source")
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "intri.yml").write_text("mine")
    with pytest.raises(UserError, match="expected a new folder, or one of an import, got one with other files"):
        bring(source, other)
    assert contents(other).keys() == {"intri.yml"}
    bring(source, tmp_path / "out")
    with pytest.raises(UserError, match="expected a new folder or an import of"):
        bring(ball_capture, tmp_path / "out")


def test_unpacked_frames_keep_their_offsets(tmp_path: Path) -> None:
    """Catches frames of two alignments side by side."""
    source = write_source(tmp_path / "source")
    bring(source, tmp_path / "out", unpack=True)
    with pytest.raises(UserError, match=r"expected the offsets with which its frames were unpacked \(none\), got b=2"):
        bring(source, tmp_path / "out", unpack=True, offsets={"b": 2})
    write_film(source / "videos" / "b.mp4", range(41))
    with pytest.raises(UserError, match="expected the videos of which its frames were unpacked, got others"):
        bring(source, tmp_path / "out", unpack=True)


def test_a_damaged_record_is_told(tmp_path: Path) -> None:
    """Catches a traceback, and a guess at whose the folder is."""
    source, out = write_source(tmp_path / "source"), tmp_path / "out"
    bring(source, out)
    record = out / ".fourd" / "import.json"
    for text in ("{", "[]", json.dumps({"version": 9}), json.dumps({"version": 1, "warnings": []})):
        record.write_text(text)
        with pytest.raises(UserError, match="expected the record of an import"):
            bring(source, out)


def test_easymocap_goes_round(ball_capture: Path, tmp_path: Path) -> None:
    """Catches pixels or poses that an import changes though there is nothing to convert."""
    bring(ball_capture, tmp_path / "out")
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


def test_known_offsets_are_estimated_and_those_alone_applied(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches an estimate of the wrong sign, and --sync that applies what it should only tell."""
    levels = np.cumsum(rng.integers(1, 64, 100)) % 64
    numbers = {"a": levels[:84], "b": levels[9:93], "c": levels[:84]}
    source = write_source(tmp_path / "source", {name: of.tolist() for name, of in numbers.items()})
    lines = bring(source, tmp_path / "told", sync=True)
    assert any(line.startswith("b: -9 frames") for line in lines)
    assert (tmp_path / "told" / ".fourd" / "sync.png").is_file()
    assert open_capture(tmp_path / "told").frame_count == 84
    lines = bring(source, tmp_path / "out", apply_sync=True)
    assert any(line.startswith("b: -9 frames") and "applied" in line for line in lines)
    capture = open_capture(tmp_path / "out")
    assert capture.frame_count == 75
    assert {number_of(capture.image(camera, 0)) for camera in range(3)} == {int(levels[9])}
