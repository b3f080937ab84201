"""Chroma keying of synthetic images with uneven light, a shadow and noise, compared with the true alpha."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.matting.chroma import ScreenColour, chroma_matte, find_screen, parse_screen, screen_distance

Picture = NDArray[np.uint8]
Floats = NDArray[np.float64]

SIZE = (300, 400)
GREEN = (40, 170, 70)
BLUE = (30, 60, 190)


def subject_alpha() -> Floats:
    """Alpha of a body with a head, two thin legs, and an arm that encloses a hole. Each pixel has 4 x 4 samples."""
    height, width = SIZE
    large = np.zeros((4 * height, 4 * width), np.uint8)

    def at(x: float, y: float) -> tuple[int, int]:
        return int(4 * x), int(4 * y)

    cv2.ellipse(large, at(200, 140), at(45, 60), 0, 0, 360, 255, -1)
    cv2.circle(large, at(200, 60), 4 * 26, 255, -1)
    for foot in (178, 226):
        cv2.line(large, at(200, 180), at(foot, 260), 255, 4 * 9)
    cv2.ellipse(large, at(255, 130), at(30, 24), 0, 0, 360, 255, 4 * 8)
    alpha = cv2.GaussianBlur(cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA), (0, 0), 0.8)
    return np.asarray(alpha, np.float64) / 255


def synthetic_picture(
    rng: np.random.Generator, screen: tuple[int, int, int], shadow: float = 0.6
) -> tuple[Picture, Floats]:
    """A noisy image and its alpha. The illumination falls from 1.1 to 0.75, and there is a shadow beside the feet."""
    height, width = SIZE
    alpha = subject_alpha()
    y, x = np.mgrid[:height, :width]
    light = 1.1 - 0.35 * np.hypot((x - 120) / width, (y - 80) / height)
    dark = np.zeros(SIZE)
    cv2.ellipse(dark, (250, 262), (90, 18), 0, 0, 360, 1.0, -1)
    light *= 1 - (1 - shadow) * cv2.GaussianBlur(dark, (0, 0), 4)
    # The subject has stripes in the colours skin, black, white, red and grey.
    clothes = np.array([(205, 150, 125), (25, 25, 30), (235, 235, 235), (170, 40, 45), (120, 120, 125)], float)
    subject = clothes[(y // 34) % len(clothes)]
    picture = alpha[..., None] * subject + (1 - alpha[..., None]) * light[..., None] * np.array(screen, float)
    return np.clip(picture + rng.normal(0, 2.5, picture.shape) + 0.5, 0, 255).astype(np.uint8), alpha


def overlap(matte: Picture, alpha: Floats) -> float:
    found, true = matte > 127, alpha > 0.5
    return float((found & true).sum() / (found | true).sum())


@pytest.mark.parametrize("colour", [GREEN, BLUE])
def test_uneven_light_and_shadow_are_not_foreground(rng: np.random.Generator, colour: tuple[int, int, int]) -> None:
    """Catches colour distances in RGB, which classify the dark side of the screen or the shadow as foreground."""
    picture, alpha = synthetic_picture(rng, colour)
    matte = chroma_matte(picture, find_screen([picture]))
    error = np.abs(matte / 255.0 - alpha)
    assert matte.dtype == np.uint8
    assert overlap(matte, alpha) > 0.985
    assert error.mean() < 0.0025
    # The error in the soft edge must be small. A distance that ignores luma has an error of 0.15, because it fails on
    # dark clothes.
    assert error[(alpha > 0.02) & (alpha < 0.98)].mean() < 0.06
    assert (matte[alpha < 1e-3] > 64).mean() < 2e-4
    assert (matte[alpha > 0.999] < 192).mean() < 2e-3


def test_large_holes_in_the_subject_stay_open(rng: np.random.Generator) -> None:
    """Catches large holes in the subject that are filled, such as the hole between an arm and the body."""
    picture, _ = synthetic_picture(rng, GREEN)
    assert chroma_matte(picture, find_screen([picture]))[130, 258] == 0


def test_specks_are_removed_and_an_empty_picture_stays_empty(rng: np.random.Generator) -> None:
    """Catches dirt on the screen that is classified as foreground, and noise that is classified as foreground."""
    picture, _ = synthetic_picture(rng, GREEN)
    screen = find_screen([picture])
    picture[20:23, 30:33] = (200, 120, 200)
    assert not chroma_matte(picture, screen)[10:34, 20:44].any()
    empty = np.full((200, 300, 3), GREEN, np.uint8)
    assert not chroma_matte(empty, screen).any()


def test_screen_colour_is_that_of_its_median_light(rng: np.random.Generator) -> None:
    """Catches an estimate of the screen colour that returns the colour of a shadow, or of a subject at the image
    border."""
    picture, _ = synthetic_picture(rng, GREEN)
    picture[250:, :120] = (190, 150, 130)
    screen = find_screen([picture, picture[:, ::-1]])
    ratio = np.array(screen.rgb) / np.array(GREEN)
    assert ratio.min() > 0.75
    assert ratio.max() < 1.1
    assert ratio.max() / ratio.min() < 1.08
    assert screen.spread < 0.25


@pytest.mark.parametrize("kind", ["noise", "grey", "stripes"])
def test_pictures_without_a_screen_are_refused(rng: np.random.Generator, kind: str) -> None:
    """Catches arbitrary backgrounds that are accepted as a screen of one colour."""
    picture = rng.integers(0, 256, (120, 160, 3)).astype(np.uint8)
    if kind == "grey":
        picture = (130 + picture // 32).astype(np.uint8)
    elif kind == "stripes":
        picture = np.array([GREEN, BLUE, (190, 60, 40)], np.uint8)[np.arange(160) // 3 % 3][None].repeat(120, 0)
    with pytest.raises(UserError, match=r"^the images: expected a screen of one colour, got .*--screen R,G,B"):
        find_screen([picture])


def test_parse_screen_validates_its_argument() -> None:
    """Catches grey screen colours and typing errors that are accepted and make every matte empty or full."""
    assert parse_screen("0,177, 64") == ScreenColour((0.0, 177.0, 64.0))
    for text in ("0,177", "green", "0,300,0", "0,-1,4", "1.5,2,3"):
        with pytest.raises(UserError, match=r"^--screen: expected R,G,B"):
            parse_screen(text)
    with pytest.raises(UserError, match="nearly grey"):
        parse_screen("128,130,128")


def test_distance_is_zero_in_any_light_and_one_for_greys() -> None:
    """Catches chroma values that are compared without scaling them to the luma of the pixel."""
    screen = ScreenColour(GREEN)
    light = np.linspace(0.45, 1.3, 9)[:, None] * np.array(GREEN)
    np.testing.assert_allclose(screen_distance(light, screen), 0, atol=1e-3)
    greys = np.array([[90, 90, 90], [0, 0, 0], [200, 200, 200]], np.uint8)
    np.testing.assert_allclose(screen_distance(greys, screen), 1, atol=1e-3)
