"""Offsets between cameras from how much moves: known shifts, noise, gains, cameras without motion, a real recording."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fourd.sync.motion import Offsets, _solve, estimate_offsets, motion_energy, plot_offsets

CAPTURES = Path(__file__).parents[2].parent / "shared" / "captures"
Array = NDArray[np.float64]


def _movement(rng: np.random.Generator, frames: int) -> Array:
    """An energy with bursts, as steps and claps make them."""
    return np.exp(gaussian_filter1d(rng.normal(size=frames), 1.5) * 3)


def _energies(rng: np.random.Generator, shifts: list[int], frames: int = 160, noise: float = 0.15) -> list[Array]:
    """Energies of one movement in cameras that run behind by ``shifts``, each with a gain and noise of its own."""
    movement = _movement(rng, frames + 100)
    return [
        rng.uniform(0.2, 5) * movement[50 - shift : 50 - shift + frames] * np.exp(noise * rng.normal(size=frames))
        for shift in shifts
    ]


def test_known_shifts_are_found_whatever_the_gain_and_noise(rng: np.random.Generator) -> None:
    """Catches a wrong sign, offsets that are not counted from the first camera, and gains that matter."""
    shifts = [0, 7, -12, 3, 25]
    offsets = estimate_offsets(_energies(rng, shifts), most=40)
    assert offsets.frames == tuple(shifts)
    np.testing.assert_allclose(offsets.subframes, shifts, atol=0.3)
    assert min(offsets.confidence) > 0.3


def test_an_offset_is_where_the_event_is_later_in_the_video() -> None:
    """Catches the opposite sign: the capture's frame f is the video's frame f + o."""
    first, late = np.full(80, 1.0), np.full(80, 1.0)
    first[[20, 41, 47]] = 9
    late[[25, 46, 52]] = 9
    offsets = estimate_offsets([first, late], most=10)
    assert offsets.frames == (0, 5)


def test_a_camera_that_lost_its_beginning_has_a_negative_offset(rng: np.random.Generator) -> None:
    """Catches lengths that must be equal."""
    one, other = _energies(rng, [0, 0])
    assert estimate_offsets([one, other[9:]], most=20).frames == (0, -9)


def test_half_a_frame_shows_in_the_subframes(rng: np.random.Generator) -> None:
    """Catches parabolas that are left out or turned round."""
    fine = np.exp(gaussian_filter1d(rng.normal(size=800), 8) * 6)
    offsets = estimate_offsets([fine[100:700:4], fine[98:698:4]], most=10)
    assert abs(offsets.subframes[1] - 0.5) < 0.2


def test_a_camera_without_motion_is_not_believed_and_does_not_spoil_the_others(rng: np.random.Generator) -> None:
    """Catches a flat or random correlation that counts as much as a sharp one."""
    energies = _energies(rng, [0, 4, -6, 2])
    energies.append(np.zeros(160))
    energies.append(np.exp(0.1 * rng.normal(size=160)))
    offsets = estimate_offsets(energies, most=30)
    assert offsets.frames[:4] == (0, 4, -6, 2)
    assert min(offsets.confidence[:4]) > 0.3
    assert offsets.confidence[4] == 0
    assert offsets.confidence[5] < 0.4 * min(offsets.confidence[:4])


def test_one_wrong_pair_does_not_move_the_solution(rng: np.random.Generator) -> None:
    """Catches plain least squares: two cameras share a second movement that the others do not see."""
    shifts = np.array([0, 5, 5, -3, -3])
    pairs = list(combinations(range(5), 2))
    lags = np.array([shifts[j] - shifts[i] + rng.uniform(-0.2, 0.2) for i, j in pairs])
    wrong = int(rng.integers(len(pairs)))
    lags[wrong] += rng.choice([-1, 1]) * rng.uniform(5, 25)
    trust = rng.uniform(0.6, 0.8, len(pairs))
    trust[wrong] = 0.8
    np.testing.assert_allclose(_solve(pairs, lags, trust, 5), shifts, atol=0.8)


def test_one_camera_alone_is_in_time_with_itself() -> None:
    """Catches a crash without pairs."""
    assert estimate_offsets([np.ones(40)], most=5).frames == (0,)


def test_too_few_frames_are_refused() -> None:
    """Catches correlations over next to nothing, which are always high."""
    with pytest.raises(ValueError, match="expected at most 8 frames of 20, got 10"):
        estimate_offsets([np.ones(20), np.ones(30)], most=10)


def _scene(rng: np.random.Generator, places: list[int]) -> list[NDArray[np.float64]]:
    backdrop = gaussian_filter1d(rng.uniform(40, 200, size=(60, 80)), 2, axis=1)
    pictures = []
    for place in places:
        picture = backdrop.copy()
        picture[20:40, place : place + 12] = 205
        pictures.append(picture)
    return pictures


def test_energy_follows_motion_and_not_exposure_or_noise(rng: np.random.Generator) -> None:
    """Catches an energy that a flickering lamp or a noisy sensor fills."""
    still = _scene(rng, [30] * 8)
    moving = _scene(rng, [30, 30, 34, 44, 44, 44, 45, 45])
    gains = np.array([1.0, 1.0, 1.15, 1.0, 0.85, 1.0, 1.0, 1.2])

    def filmed(pictures: list[NDArray[np.float64]]) -> list[NDArray[np.uint8]]:
        return [
            np.clip(gain * picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
            for picture, gain in zip(pictures, gains, strict=True)
        ]

    energy, flicker = motion_energy(iter(filmed(moving))), motion_energy(iter(filmed(still)))
    assert energy.shape == (8,)
    assert energy[0] == energy[1]
    assert energy[3] > energy[2] > energy[6] > 2 * flicker.max()
    assert flicker.max() < 0.05 * energy[3]


def test_no_pictures_have_no_energy_and_other_sizes_are_refused() -> None:
    """Catches a crash on an empty video, and a resize in the middle that would look like motion."""
    assert motion_energy([]).shape == (0,)
    with pytest.raises(ValueError, match="as the one before"):
        motion_energy([np.zeros((4, 4), np.uint8), np.zeros((4, 5), np.uint8)])


def test_the_plot_shows_every_camera_before_and_after(rng: np.random.Generator, tmp_path: Path) -> None:
    """Catches an unreadable file, and a right side that is not shifted."""
    energies = _energies(rng, [0, 20, -20])
    offsets = Offsets((0, 20, -20), (0.0, 20.0, -20.0), (0.9, 0.8, 0.05))
    plot_offsets(tmp_path / "sync.png", ["front", "side", "back"], energies, offsets)
    picture = cv2.imread(str(tmp_path / "sync.png"))
    unmoved = Offsets((0, 0, 0), (0.0, 0.0, 0.0), offsets.confidence)
    plot_offsets(tmp_path / "same.png", ["front", "side", "back"], energies, unmoved)
    same = cv2.imread(str(tmp_path / "same.png"))
    half = 250 + 480
    changed = (picture != same).any(axis=(0, 2))
    assert not changed[250:half].any()
    assert changed[half + 16 :].sum() > 300


@pytest.fixture(scope="module")
def balance() -> list[Array]:
    """Energies of the four genlocked videos of the real capture."""
    folder = CAPTURES / "balance"
    if not folder.is_dir():
        pytest.skip(f"no real capture at {folder}")
    energies = []
    for path in sorted(folder.glob("*.mp4")):
        with av.open(str(path)) as video:
            frames = video.decode(video=0)
            energies.append(
                motion_energy(f.reformat(width=136, height=240, format="gray").to_ndarray() for f in frames)
            )
    return energies


@pytest.mark.slow
def test_seven_lost_frames_of_a_real_camera_are_found(balance: list[Array]) -> None:
    """Catches an estimate that works on synthetic bursts alone. Which camera lost frames does not matter."""
    whole = estimate_offsets(balance, most=20)
    for camera in range(1, 4):
        cut = [energy[7:] if index == camera else energy for index, energy in enumerate(balance)]
        offsets = estimate_offsets(cut, most=20)
        assert abs(offsets.subframes[camera] - whole.subframes[camera] + 7) < 1
        assert offsets.confidence[camera] > 0.2


@pytest.mark.slow
def test_genlocked_cameras_are_in_time_to_three_frames(balance: list[Array]) -> None:
    """Catches a bias larger than the one that different sides of a smooth movement make (0, 2, 1, 2 frames here)."""
    offsets = estimate_offsets(balance, most=20)
    assert max(map(abs, offsets.frames)) <= 3
