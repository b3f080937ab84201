"""The rate of drawn images."""

from __future__ import annotations

import pytest

from fourd.viewer.timings import Timings


def test_the_rate_is_that_of_drawn_images() -> None:
    """Catches a rate that stays after the last image, one that counts single images, and one that is 0 on slow
    machines."""
    timings = Timings()
    assert timings.images_per_second(0.0) == 0
    for image in range(100):
        timings.count_image(image / 50)
    assert timings.images_per_second(2.0) == pytest.approx(50)
    assert timings.images_per_second(2.6) == 0
    for second in (30.0, 31.5, 33.0):
        timings.count_image(second)
    assert timings.images_per_second(33.5) == pytest.approx(1 / 1.5)
