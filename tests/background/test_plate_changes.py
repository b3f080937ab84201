"""Detection of backgrounds that change over time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fourd.reconstruction.background.plate_changes import find_changing_backgrounds
from fourd.reconstruction.background.plates import PlateView
from fourd.recording.capture import open_capture


def plate_views(path: Path) -> list[PlateView]:
    """Clean plates of the capture's grey room, a few grey levels brighter than the capture's images."""
    capture = open_capture(path, frames="0:1")
    views = []
    for index, camera in enumerate(capture.cameras):
        rgb, matte = capture.image(index, 0), capture.mask(index, 0)
        room = np.median(rgb[matte == 0], axis=0) + 5
        views.append(
            PlateView(capture.names[index], camera, np.tile(room, (*matte.shape, 1)).astype(np.uint8), matte >= 0)
        )
    return views


def test_subject_and_exposure_are_not_changes(ball_capture: Path) -> None:
    """Catches a static background that is reported as changing because of the subject or a different exposure."""
    capture = open_capture(ball_capture)
    assert find_changing_backgrounds(capture, range(len(capture.names)), plate_views(ball_capture)) == {}


def test_changes_outside_the_matte_are_found(ball_capture: Path) -> None:
    """Catches a changing background that is not reported."""
    capture, plates = open_capture(ball_capture), plate_views(ball_capture)
    changed = plates[1].rgb.copy()
    changed[:8] = 255 - changed[:8]
    plates[1] = replace(plates[1], rgb=changed)
    found = find_changing_backgrounds(capture, range(len(plates)), plates)
    assert list(found) == [capture.names[1]]
    assert 0.08 < found[capture.names[1]] < 0.25
