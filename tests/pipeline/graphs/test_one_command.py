"""``fourd make`` on videos: what it finds and decides by itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.pipeline.facts import MaskFacts
from fourd.pipeline.graphs.capture import needs_import
from fourd.pipeline.graphs.plan import Forecast
from fourd.pipeline.graphs.run import RunRequest
from fourd.pipeline.graphs.scene import SceneStages
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.board_calibration.search import find_board_recording
from fourd.recording.importing.detection import pick_format
from fourd.recording.importing.importer import ImportOptions, import_source
from fourd.scene.container import SceneReader
from tests.capture.numbered_videos import write_numbered_video
from tests.importing.test_layouts import pose2sim

BOARD = "columns = 5\nrows = 4\nsquare_m = 0.05\n"


def write_videos(folder: Path, count: int = 2, frames: int = 4) -> Path:
    folder.mkdir(parents=True)
    for number in range(count):
        write_numbered_video(folder / f"cam{number}.mp4", range(frames))
    return folder


def no_log(line: str) -> None:
    raise AssertionError(f"unexpected line: {line}")


@pytest.mark.parametrize(
    ("board", "recording"),
    [
        ("board.toml", "board"),
        ("videos/board.toml", "videos/board"),
        ("filmed/board.toml", "filmed"),
        ("filmed/board.toml", "filmed/videos"),
        ("board.toml", "calibration_videos"),
    ],
)
def test_a_recording_of_a_board_is_found(board: str, recording: str, tmp_path: Path) -> None:
    """Catches a board recording that is overlooked, so that cameras are calibrated from the scene instead."""
    source = write_videos(tmp_path / "videos")
    write_videos(tmp_path / recording)
    (tmp_path / board).write_text(BOARD)
    found = find_board_recording(source, no_log)
    assert found is not None
    assert found.board.resolve() == (tmp_path / board).resolve()
    expected = tmp_path / recording
    assert found.videos.resolve() in (expected.resolve(), expected.parent.resolve())


def test_the_subjects_videos_are_not_taken_for_the_boards(tmp_path: Path) -> None:
    """Catches a calibration from the videos of the subject, because the board's file is in the folder above."""
    source = write_videos(tmp_path / "videos")
    assert find_board_recording(source, no_log) is None
    (tmp_path / "board.toml").write_text(BOARD)
    lines: list[str] = []
    assert find_board_recording(source, lines.append) is None
    assert "no recording of this board beside it" in lines[0]


def test_two_recordings_of_boards_are_refused(tmp_path: Path) -> None:
    """Catches a silent choice between two calibrations."""
    source = write_videos(tmp_path / "videos")
    for name in ("before", "after"):
        write_videos(tmp_path / name)
        (tmp_path / name / "board.toml").write_text(BOARD)
    with pytest.raises(UserError, match=r"expected one recording of a calibration board, got .*after, .*before"):
        find_board_recording(source, no_log)


def test_the_board_is_calibrated_before_the_import(tmp_path: Path) -> None:
    """Catches an import that ignores the calibration of the stage before it, and a board that replaces the user's own
    calibration."""
    source = write_videos(tmp_path / "videos")
    write_videos(tmp_path / "board")
    (tmp_path / "board.toml").write_text(BOARD)
    look, work = Forecast(MaskFacts(("cam0", "cam1"), (), False), 4), tmp_path / "work"
    run = RunRequest(source, work / "run", TrainConfig(max_steps=1))

    def stages(options: ImportOptions) -> list[tuple[str, object]]:
        listed = SceneStages(source, run, options, work, tmp_path / "scene.4dv")
        return [(stage.name, stage.settings) for group in listed.groups(look) for stage in group]

    found = stages(ImportOptions())
    assert [name for name, _ in found][:5] == ["calibrate", "import", "check", "repair", "mattes"]
    assert found[1][1].calibration == str(work / "calibration")  # type: ignore[attr-defined]
    assert stages(ImportOptions(calibration=str(tmp_path)))[0][0] == "import"


def test_offsets_that_cannot_be_estimated_are_no_error(tmp_path: Path) -> None:
    """Catches a short recording that fourd make refuses because its offsets cannot be estimated."""
    source, out = pose2sim(tmp_path / "session"), tmp_path / "capture"
    lines: list[str] = []
    import_source(
        pick_format(None, source),
        source,
        out,
        ImportOptions(sync_if_possible=True),
        log=lines.append,
        warn=lines.append,
        track=lambda items, *_: items,
    )
    assert any(
        line.startswith("time offsets between the videos are not estimated: expected more than") for line in lines
    )


def test_the_scene_is_packed_and_its_page_is_written(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a scene file of several times the necessary size, a page that is missing, and decisions that are not
    reported."""
    scene, site = tmp_path / "scene.4dv", tmp_path / "site"
    words = ["make", str(ball_capture), "-o", str(scene), "--points", "300", "--max-steps", "2"]
    assert main([*words, "--web", str(site)]) == 0
    encoding = SceneReader(scene).manifest.encoding
    assert encoding is not None
    assert encoding.tier == "full"
    assert (site / "index.html").is_file()
    printed = " ".join(capsys.readouterr().out.split())
    assert "decided: colours: left as they are; --refine-colours corrects them" in printed
    assert main([*words, "--tier", "none"]) == 0
    assert SceneReader(scene).manifest.encoding is None


def test_frames_that_the_capture_lacks_are_refused_before_the_repair(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a mistake in --frames that is reported only after the repair, which takes minutes."""
    assert main(["make", str(ball_capture), "-o", str(tmp_path / "scene.4dv"), "--frames", "0:9"]) == 2
    printed = capsys.readouterr()
    assert "--frames: expected A:B with 0 <= A < B <= 3, since the capture has 3 frames, got '0:9'" in printed.err
    assert "check: finished" in printed.out
    assert "repair: running" not in printed.out


def test_offsets_for_a_capture_are_refused(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an option --offset that is silently ignored, because the frames of a capture are already aligned."""
    assert main(["make", str(ball_capture), "-o", str(tmp_path / "scene.4dv"), "--offset", "00=3"]) == 2
    assert f"--offset: expected videos, got the capture {ball_capture}" in " ".join(capsys.readouterr().err.split())


def test_calibrated_videos_are_imported_to_be_synchronised(tmp_path: Path) -> None:
    """Catches a folder of videos with a calibration whose offsets are never estimated, because it is a capture as it
    is, and an imported capture or one with mattes that is imported again."""
    folder = tmp_path / "session"
    write_videos(folder / "videos")
    for name in ("intri.yml", "extri.yml"):
        (folder / name).write_text("%YAML:1.0\n")
    assert needs_import(folder, ImportOptions(sync_if_possible=True))
    assert needs_import(folder, ImportOptions(offsets={"cam0": 3.0}))
    assert not needs_import(folder, ImportOptions())
    (folder / ".fourd").mkdir()
    (folder / ".fourd" / "import.json").write_text("{}")
    assert not needs_import(folder, ImportOptions(sync_if_possible=True))
