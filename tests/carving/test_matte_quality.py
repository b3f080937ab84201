"""Agreement of each matte with the visual hull of the other views."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.reconstruction.carving.coherence import frame_coherence
from fourd.reconstruction.carving.matte_quality import MatteQuality, measure_mattes
from fourd.recording.importing.record import ImportRecord, write_record
from tests.captures import ring_cameras
from tests.carving.shapes import MemoryCapture, ball, mask

CENTRE, RADIUS = (0.1, -0.05, 0.02), 0.35


def capture(cameras: int = 8, frames: int = 1) -> MemoryCapture:
    views = tuple(ring_cameras(cameras, 96))
    return MemoryCapture(views, [[mask(view, [ball(CENTRE, RADIUS)]) for view in views] for _ in range(frames)])


@pytest.mark.parametrize("count", [4, 8])
def test_true_mattes_explain_each_other(count: int) -> None:
    """Catches cells that are too coarse for thin shapes, and silhouettes with gaps between the cells."""
    views = capture(count)
    found = frame_coherence(views.masks[0], views.cameras)
    assert found.explained.min() > 0.97
    assert found.overlap.min() > 0.93


def test_a_matte_with_background_is_named() -> None:
    """Catches a report that names good views instead of the poor view. Also catches a range of poor frames that
    contains a good frame."""
    views = capture(8, 4)
    for frame in (0, 1, 3):
        views.masks[frame][2] = np.full_like(views.masks[frame][2], 255)
    quality = measure_mattes(views)
    assert quality is not None
    assert [line.split(":")[0] for line in sorted(quality.warnings())] == [
        f"{views.names[2]}, frame 3",
        f"{views.names[2]}, frames 0 to 1",
    ]
    assert all(
        "the hull of the other views covers" in line and line.endswith("% of this matte") for line in quality.warnings()
    )


def test_contradicting_mattes_stop_carving(tmp_path: Path) -> None:
    """Catches carving without an error although the hull covers only a small part of the mattes."""
    views = capture(5)
    small = [mask(view, [ball(CENTRE, 0.1)]) for view in views.cameras]
    views.masks[0][1], views.masks[0][3] = small[1], small[3]
    quality = measure_mattes(views)
    assert quality is not None
    assert quality.kept_share < 1 / 3
    with pytest.raises(UserError, match=r"the visual hull covers at least a third, got \d+% \(.*--accept-mattes"):
        quality.require_hull(tmp_path)
    with pytest.raises(UserError, match=r"of this matte\); camera 3 is late; otherwise, fix the mattes"):
        quality.require_hull(tmp_path, "camera 3 is late")
    good = measure_mattes(capture(5))
    assert good is not None
    good.require_hull(tmp_path)


def test_empty_mattes_are_not_scored(tmp_path: Path) -> None:
    """Catches a division by zero, and NaN in the JSON file, which is not valid JSON."""
    views = capture(5)
    views.masks[0] = [np.zeros_like(picture) for picture in views.masks[0]]
    quality = measure_mattes(views)
    assert isinstance(quality, MatteQuality)
    assert quality.kept_share == 1
    quality.save(tmp_path / "quality.json")
    assert json.loads((tmp_path / "quality.json").read_text())["explained"] == [[None] * 5]


def test_two_views_have_no_score() -> None:
    """Catches a warning for a capture with two cameras. Two silhouettes nearly always have a common hull, so two views
    cannot disagree."""
    assert measure_mattes(capture(2)) is None


def test_the_error_names_an_offset_that_was_not_applied(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an error that names mattes and calibration only, although a camera is probably late."""
    copy = tmp_path / "capture"
    shutil.copytree(ball_capture, copy)
    unsure = {"03": 12.0}
    write_record(copy, ImportRecord("videos", "videos", "", "", {}, {}, False, True, (), unsure))
    for path in sorted((copy / "masks").glob("0[2367]/*.png")):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(path), np.roll(picture, picture.shape[1] // 2, axis=1))
    assert main(["carve", str(copy), "--out", str(tmp_path / "hull")]) == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert "the visual hull covers at least a third" in printed
    assert "time offsets were found but not applied, because they are not sure (03 +12 frames)" in printed
    assert "add --offset 03=12 to fourd make or fourd import; otherwise, fix the mattes" in printed
