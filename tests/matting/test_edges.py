"""Alpha at the edge of a mask, compared with the exact coverage of pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from fourd.recording.matting.edges import estimate_edge_alpha

SIZE, OVERSAMPLING = 96, 8
FUR, WALL = np.array([200.0, 130, 60]), np.array([90.0, 100, 120])
PAINT, FLOOR = np.array([210.0, 210, 205]), np.array([110.0, 100, 90])
CONTOUR_PX = 2 * np.pi * 30


def disc_coverage(offset_px: float) -> np.ndarray:
    """Coverage (SIZE, SIZE) of the pixels by a disc whose centre is shifted by ``offset_px``."""
    at = (np.arange(SIZE * OVERSAMPLING) + 0.5) / OVERSAMPLING - SIZE / 2
    inside = (at[:, None] ** 2 + (at[None] - offset_px) ** 2 < 30**2).astype(np.float32)
    return np.asarray(cv2.resize(inside, (SIZE, SIZE), interpolation=cv2.INTER_AREA))


@pytest.mark.parametrize("is_known", [True, False], ids=["known background", "unknown background"])
@pytest.mark.parametrize("grown_px", [-1, 0, 1])
def test_alpha_is_the_coverage_of_edge_pixels(is_known: bool, grown_px: int, rng: np.random.Generator) -> None:
    """Catches edges that are softer than in the image, and masks that remain a pixel too large or too small."""
    truth = disc_coverage(0.3)
    rgb = truth[..., None] * FUR + (1 - truth[..., None]) * WALL + rng.normal(0, 2, (SIZE, SIZE, 3))
    mask = (truth > 0.5).astype(np.uint8)
    mask = (cv2.erode, np.asarray, cv2.dilate)[grown_px + 1](mask, *([np.ones((3, 3), np.uint8)] * abs(grown_px)))
    plate = np.dstack([np.broadcast_to(WALL, (SIZE, SIZE, 3)), np.ones((SIZE, SIZE))]).astype(np.float32)
    alpha = estimate_edge_alpha(np.clip(rgb, 0, 255).astype(np.uint8), mask, 1, plate if is_known else None)
    assert np.abs(alpha - truth).sum() / CONTOUR_PX < 0.25
    assert abs((alpha - truth).sum()) / CONTOUR_PX < 0.12


def test_edges_of_shaded_subjects_stay_in_place(rng: np.random.Generator) -> None:
    """Catches edges that move 0.65 pixels into a white subject whose light falls off towards its contour."""
    truth = disc_coverage(0.3)
    at = np.arange(SIZE) + 0.5 - SIZE / 2
    slope = np.clip(1 - (at[:, None] ** 2 + (at[None] - 0.3) ** 2) / 30**2, 0, 1)
    light = (0.5 + 0.5 * np.sqrt(slope))[..., None]
    rgb = truth[..., None] * light * PAINT + (1 - truth[..., None]) * FLOOR + rng.normal(0, 2, (SIZE, SIZE, 3))
    plate = np.dstack([np.broadcast_to(FLOOR, (SIZE, SIZE, 3)), np.ones((SIZE, SIZE))]).astype(np.float32)
    alpha = estimate_edge_alpha(np.clip(rgb, 0, 255).astype(np.uint8), (truth > 0.5).astype(np.uint8), 1, plate)
    assert abs((alpha - truth).sum()) / CONTOUR_PX < 0.5


def test_edges_follow_luma_where_chroma_is_blurred(rng: np.random.Generator) -> None:
    """Catches edges that follow the chroma of JPEG images, which has half the resolution of the luma. A mask that is a
    pixel too large then stays 0.2 pixels too large."""
    truth = disc_coverage(0.3)
    rgb = truth[..., None] * FUR + (1 - truth[..., None]) * WALL + rng.normal(0, 2, (SIZE, SIZE, 3))
    bgr = np.clip(rgb, 0, 255).astype(np.uint8)[..., ::-1]
    stored = cv2.imdecode(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 92])[1], cv2.IMREAD_COLOR)
    plate = np.dstack([np.broadcast_to(WALL, (SIZE, SIZE, 3)), np.ones((SIZE, SIZE))]).astype(np.float32)
    mask = cv2.dilate((truth > 0.5).astype(np.uint8), np.ones((3, 3), np.uint8))
    alpha = estimate_edge_alpha(np.ascontiguousarray(stored[..., ::-1]), mask, 1, plate)
    assert (alpha - truth).sum() / CONTOUR_PX < 0.13
