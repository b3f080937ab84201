"""Features of images that are only a few pixels high."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.recording.stereo.colmap import KNOWN_CAMERAS, Extraction, temporary_workspace


@pytest.mark.parametrize("size", [(15, 48), (3, 3), (16, 16)])
@pytest.mark.parametrize("settings", [KNOWN_CAMERAS, Extraction(domain_size_pooling=True)])
def test_small_images_have_features_or_none(
    size: tuple[int, int], settings: Extraction, rng: np.random.Generator
) -> None:
    """Catches a crash of COLMAP's feature detector, which ends the process."""
    pictures = [rng.integers(0, 256, (*size, 3), np.uint8) for _ in range(2)]
    with temporary_workspace("small") as workspace:
        workspace.extract_features(pictures, settings)
        with workspace.open() as database:
            assert len(database.images) == 2
            assert database.features(0).descriptors.ndim == 2


def test_the_reduced_side_decides() -> None:
    """Catches a long image that is large enough before its reduction, and too low after it."""
    assert Extraction().reduced_side(40, 9600) == pytest.approx(40 / 3)
    assert KNOWN_CAMERAS.reduced_side(1080, 1920) == 900
