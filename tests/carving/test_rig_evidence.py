"""What the mattes of a subject say about a calibration: right, wrong in a common way, and cases that do not tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.reconstruction.carving.rig_evidence import MISTAKES, check_rig
from tests.captures import ring_cameras
from tests.carving.shapes import MemoryCapture, ball, mask

NAMES = {name.split()[0]: name for name in MISTAKES}


def figure(views: int = 8, moments: int = 3, *, shift: float = 0.0) -> MemoryCapture:
    """A body without symmetry that moves: a large, a small and a distant ball."""
    cameras = tuple(ring_cameras(views, 64))
    masks = []
    for moment in range(moments):
        x = 0.15 * moment - 0.15 + shift
        shapes = [ball((x, 0, 0), 0.25), ball((x + 0.35, 0.1, 0.15), 0.13), ball((x, -0.4, -0.2), 0.1)]
        masks.append([mask(camera, shapes) for camera in cameras])
    return MemoryCapture(cameras, masks)


def test_a_right_calibration_is_verified() -> None:
    """Catches a check that never says that a rig is right, so that nobody listens when it says that one is wrong."""
    found = check_rig(figure())
    assert (found.finding, found.likely) == ("verified", "")
    assert found.covered > 0.9


@pytest.mark.parametrize("mistake", ["inverted", "camera", "neighbouring"])
def test_a_common_mistake_is_named(mistake: str) -> None:
    """Catches a rig that is inverted or has exchanged cameras, and is trained for half an hour."""
    right = figure()
    name = NAMES[mistake]
    wrong = replace(right, cameras=tuple(MISTAKES[name](right.cameras)), path=Path("capture"))
    found = check_rig(wrong, verify=False)
    assert (found.finding, found.likely) == ("contradicts", name)
    with pytest.raises(UserError, match=r"^capture/extri.yml: expected .* covers \d+% of a matte .* correct the cal"):
        found.require(wrong.path)


def test_a_round_subject_in_the_middle_does_not_tell() -> None:
    """Catches "verified" for a subject that also fits wrong rigs."""
    cameras = tuple(ring_cameras(8, 64))
    found = check_rig(MemoryCapture(cameras, [[mask(camera, [ball((0, 0, 0), 0.3)]) for camera in cameras]] * 2))
    assert found.finding == "not verified"
    assert "wrong calibrations fit about as well" in str(found)


@pytest.mark.parametrize("views", [2, 3])
def test_few_cameras_are_never_refused(views: int) -> None:
    """Catches good rigs of two or three cameras that are refused."""
    found = check_rig(figure(views))
    assert found.finding != "contradicts"
    found.require(Path("capture"))


def test_poor_mattes_do_not_contradict_a_right_calibration() -> None:
    """Catches a good rig that is refused because of its mattes, which hold parts of the background."""
    capture = figure()
    rng = np.random.default_rng(0)
    for moment in capture.masks:
        for matte in moment:
            row, column = rng.integers(4, 30, 2)
            matte[row : row + 24, column : column + 12] = 255
    found = check_rig(capture)
    assert found.finding == "not verified"
    assert found.covered < 0.85


def test_mattes_at_the_edge_of_the_image_do_not_count() -> None:
    """Catches a subject that is cut off in most images, and counts as evidence against the calibration."""
    capture = figure()
    for moment in capture.masks:
        for matte in moment[:6]:
            matte[:, :30] = 255
    assert check_rig(capture).finding != "contradicts"
    for moment in capture.masks:
        for matte in moment:
            matte[:2] = 255
    assert check_rig(capture).mattes == 0
