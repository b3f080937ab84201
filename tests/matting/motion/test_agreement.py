"""Multi-view consistency of mattes: the prior of a pixel comes from the soft hull of all other views."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.recording.matting.motion.agreement import NO_CELL_LOG_ODDS, VoxelGrid
from tests.captures import ring_cameras

SIZE = 48


def silhouettes(count: int, centre: np.ndarray, radius: float) -> tuple[VoxelGrid, list[np.ndarray]]:
    """A voxel grid, and the evidence of ``count`` views: log-odds of +4 inside a ball's silhouette and -4 outside."""
    cameras = ring_cameras(count, SIZE)
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    evidence = []
    for camera in cameras:
        pixel, depth = camera.project(centre[None])
        reach = radius * camera.intrinsics[0, 0] / depth[0]
        inside = (columns - pixel[0, 0]) ** 2 + (rows - pixel[0, 1]) ** 2 < reach**2
        evidence.append(np.where(inside, 4.0, -4.0).astype(np.float32))
    return VoxelGrid.covering(np.full(3, -0.8), np.full(3, 0.8), cameras, 40), evidence


def test_prior_comes_from_the_other_views() -> None:
    """Catches a prior of a view that depends on the same view or ignores the other views."""
    cells, evidence = silhouettes(8, np.array([0.1, -0.1, 0.05]), 0.4)
    truth = evidence[2] > 0
    evidence[2] = np.zeros_like(evidence[2])
    covered = cells.scores(evidence).prior(2) > 0
    assert (covered & truth).sum() / (covered | truth).sum() > 0.8


def test_evidence_of_one_view_is_rejected() -> None:
    """Catches foreground at bystanders behind the scene, who are visible in only one view and are outside the hull."""
    cells, evidence = silhouettes(8, np.zeros(3), 0.3)
    evidence[0][2:10, 2:10] = 4.0
    prior = cells.scores(evidence).prior(0)
    assert (prior[3:9, 3:9] < 0).all()
    assert prior[SIZE // 2, SIZE // 2] > 0


def test_one_wrong_view_of_twenty_is_tolerated() -> None:
    """Catches a plain minimum over the views. With a minimum, a hole in one matte would cut a hole into the hull."""
    cells, evidence = silhouettes(20, np.zeros(3), 0.3)
    evidence[5][:] = -4.0
    box = cells.scores(evidence).box()
    assert box is not None
    assert np.allclose(box[1] - box[0], 0.6, atol=0.2)


def test_an_empty_hull_has_no_box() -> None:
    """Catches an invalid bounding box of an empty hull. The next grid would be built from this box."""
    cells, evidence = silhouettes(4, np.zeros(3), 0.3)
    for picture in evidence:
        picture[:] = -4.0
    scores = cells.scores(evidence)
    assert scores.box() is None
    assert (scores.prior(1) == NO_CELL_LOG_ODDS).all()


@pytest.mark.parametrize("count", [1, 2])
def test_few_views_are_supported(count: int) -> None:
    """Catches a crash with few views, where the rank of the order statistic exceeds the number of views."""
    cells, evidence = silhouettes(count, np.zeros(3), 0.3)
    assert cells.scores(evidence).prior(0).shape == (SIZE, SIZE)
