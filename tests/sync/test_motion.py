"""Time offsets from motion energy, for known shifts, noise, different gains, cameras without motion, and a real
recording."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fourd.recording.sync.motion import (
    LABEL,
    LAG_TOLERANCE_FRAMES,
    MARGIN,
    PANEL,
    Offsets,
    estimate_offsets,
    motion_energy,
    plot_offsets,
)
from fourd.recording.sync.pairs import solve_offsets

CAPTURES = Path(__file__).parents[2].parent / "shared" / "captures"
Array = NDArray[np.float64]


def _burst_energy(rng: np.random.Generator, frames: int) -> Array:
    """A motion energy with random bursts, similar to the bursts from steps and claps."""
    return np.exp(gaussian_filter1d(rng.normal(size=frames), 1.5) * 3)


def _energies(rng: np.random.Generator, shifts: list[int], frames: int = 160, noise: float = 0.15) -> list[Array]:
    """Motion energies of one motion, recorded by cameras whose videos are delayed by ``shifts``. Each camera has its
    own gain and noise."""
    energy = _burst_energy(rng, frames + 100)
    return [
        rng.uniform(0.2, 5) * energy[50 - shift : 50 - shift + frames] * np.exp(noise * rng.normal(size=frames))
        for shift in shifts
    ]


def test_known_shifts_are_found(rng: np.random.Generator) -> None:
    """Catches offsets of the wrong sign, offsets that are not relative to the first camera, and an influence of the
    cameras' gains."""
    shifts = [0, 7, -12, 3, 25]
    offsets = estimate_offsets(_energies(rng, shifts), max_offset=40)
    assert offsets.frames == tuple(shifts)
    np.testing.assert_allclose(offsets.subframes, shifts, atol=0.3)
    assert min(offsets.confidence) > 0.3


def test_positive_offset_means_a_late_event() -> None:
    """Catches offsets of the opposite sign. With an offset o, frame f of the capture must be frame f + o of the
    video."""
    first, late = np.full(80, 1.0), np.full(80, 1.0)
    first[[20, 41, 47]] = 9
    late[[25, 46, 52]] = 9
    offsets = estimate_offsets([first, late], max_offset=10)
    assert offsets.frames == (0, 5)


def test_late_start_has_a_negative_offset(rng: np.random.Generator) -> None:
    """Catches an estimate that requires motion energies of equal lengths."""
    one, other = _energies(rng, [0, 0])
    assert estimate_offsets([one, other[9:]], max_offset=20).frames == (0, -9)


def test_subframe_offsets(rng: np.random.Generator) -> None:
    """Catches subframe offsets without interpolation by a parabola, or with the wrong sign."""
    fine = np.exp(gaussian_filter1d(rng.normal(size=800), 8) * 6)
    offsets = estimate_offsets([fine[100:700:4], fine[98:698:4]], max_offset=10)
    assert abs(offsets.subframes[1] - 0.5) < 0.2


def test_camera_without_motion_has_no_confidence_and_no_influence(rng: np.random.Generator) -> None:
    """Catches a flat or random correlation that has as much influence as a sharp correlation."""
    energies = _energies(rng, [0, 4, -6, 2])
    energies.append(np.zeros(160))
    energies.append(np.exp(0.1 * rng.normal(size=160)))
    offsets = estimate_offsets(energies, max_offset=30)
    assert offsets.frames[:4] == (0, 4, -6, 2)
    assert min(offsets.confidence[:4]) > 0.3
    assert offsets.confidence[4] == 0
    assert offsets.confidence[5] < 0.4 * min(offsets.confidence[:4])


def test_outlier_pair_does_not_move_the_solution(rng: np.random.Generator) -> None:
    """Catches a plain least-squares fit, which a single wrong lag distorts. A wrong lag occurs if only two cameras see
    a second motion."""
    shifts = np.array([0, 5, 5, -3, -3])
    pairs = list(combinations(range(5), 2))
    lags = np.array([shifts[j] - shifts[i] + rng.uniform(-0.2, 0.2) for i, j in pairs])
    wrong = int(rng.integers(len(pairs)))
    lags[wrong] += rng.choice([-1, 1]) * rng.uniform(5, 25)
    weights = rng.uniform(0.6, 0.8, len(pairs))
    weights[wrong] = 0.8
    np.testing.assert_allclose(solve_offsets(pairs, lags, weights, 5, LAG_TOLERANCE_FRAMES), shifts, atol=0.8)


def test_single_camera_has_no_offset() -> None:
    """Catches a crash for a single camera, which has no pairs."""
    assert estimate_offsets([np.ones(40)], max_offset=5).frames == (0,)


def test_too_few_frames_are_refused() -> None:
    """Catches correlations over only a few frames, which are high for any two signals."""
    with pytest.raises(ValueError, match="expected at most 8 for videos of 20 frames, got 10"):
        estimate_offsets([np.ones(20), np.ones(30)], max_offset=10)


def _render_square(rng: np.random.Generator, positions: list[int]) -> list[NDArray[np.float64]]:
    """Images of a square at x = ``positions`` in front of a textured background."""
    backdrop = gaussian_filter1d(rng.uniform(40, 200, size=(60, 80)), 2, axis=1)
    pictures = []
    for x in positions:
        picture = backdrop.copy()
        picture[20:40, x : x + 12] = 205
        pictures.append(picture)
    return pictures


def test_energy_ignores_exposure_and_noise(rng: np.random.Generator) -> None:
    """Catches motion energy that comes from a flickering lamp or a noisy sensor."""
    still = _render_square(rng, [30] * 8)
    moving = _render_square(rng, [30, 30, 34, 44, 44, 44, 45, 45])
    gains = np.array([1.0, 1.0, 1.15, 1.0, 0.85, 1.0, 1.0, 1.2])

    def record(pictures: list[NDArray[np.float64]]) -> list[NDArray[np.uint8]]:
        return [
            np.clip(gain * picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
            for picture, gain in zip(pictures, gains, strict=True)
        ]

    energy, flicker = motion_energy(iter(record(moving))), motion_energy(iter(record(still)))
    assert energy.shape == (8,)
    assert energy[0] == energy[1]
    assert energy[3] > energy[2] > energy[6] > 2 * flicker.max()
    assert flicker.max() < 0.05 * energy[3]


def test_empty_videos_and_changing_sizes() -> None:
    """Catches a crash on an empty video, and a change of the image size that counts as motion."""
    assert motion_energy([]).shape == (0,)
    with pytest.raises(ValueError, match="like the previous image"):
        motion_energy([np.zeros((4, 4), np.uint8), np.zeros((4, 5), np.uint8)])


def test_plot_shows_energies_as_recorded_and_shifted(rng: np.random.Generator, tmp_path: Path) -> None:
    """Catches an unreadable plot file, and curves in the right panel that are not shifted."""
    energies = _energies(rng, [0, 20, -20])
    offsets = Offsets((0, 20, -20), (0.0, 20.0, -20.0), (0.9, 0.8, 0.05))
    plot_offsets(tmp_path / "sync.png", ["front", "side", "back"], energies, offsets)
    picture = cv2.imread(str(tmp_path / "sync.png"))
    unmoved = Offsets((0, 0, 0), (0.0, 0.0, 0.0), offsets.confidence)
    plot_offsets(tmp_path / "same.png", ["front", "side", "back"], energies, unmoved)
    same = cv2.imread(str(tmp_path / "same.png"))
    half = LABEL + PANEL
    changed = (picture != same).any(axis=(0, 2))
    assert not changed[LABEL:half].any()
    assert changed[half + MARGIN :].sum() > 300


@pytest.fixture(scope="module")
def balance() -> list[Array]:
    """Motion energies of the four genlocked videos of the real capture "balance"."""
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
def test_seven_missing_frames_of_a_real_camera_are_found(balance: list[Array]) -> None:
    """Catches an estimate that works only on synthetic bursts. In each case, the first frames of one real camera are
    missing."""
    whole = estimate_offsets(balance, max_offset=20)
    for camera in range(1, 4):
        cut = [energy[7:] if index == camera else energy for index, energy in enumerate(balance)]
        offsets = estimate_offsets(cut, max_offset=20)
        assert abs(offsets.subframes[camera] - whole.subframes[camera] + 7) < 1
        assert offsets.confidence[camera] > 0.2


@pytest.mark.slow
def test_genlocked_cameras_have_offsets_up_to_three_frames(balance: list[Array]) -> None:
    """Catches errors of more than 3 frames on genlocked videos. Different views of a smooth motion cause errors of 0,
    2, 1 and 2 frames here."""
    offsets = estimate_offsets(balance, max_offset=20)
    assert max(map(abs, offsets.frames)) <= 3
