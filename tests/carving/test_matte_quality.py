"""Agreement of each matte with the visual hull of the other views."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.reconstruction.carving.coherence import frame_coherence
from fourd.reconstruction.carving.matte_quality import MatteQuality, measure_mattes
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
