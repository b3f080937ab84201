"""Score held-out views by PSNR, SSIM and LPIPS, on whole images and in the matte's bounding box."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.reconstruction.training.evaluation.metrics import mask_box, psnr, ssim
from fourd.reconstruction.training.losses.lpips import LPIPS

BOX_MARGIN_PX = 8
MIN_SIDE_PX = 11
"""Smallest image side, in pixels, for which SSIM and LPIPS are computed. The SSIM window is 11 pixels wide."""


@dataclass(frozen=True)
class Scores:
    """Scores of an image. ``psnr`` is in dB. ``ssim`` and ``lpips`` are None if the image is smaller than the SSIM
    window. ``lpips`` is also None if the network weights of LPIPS are missing."""

    psnr: float
    ssim: float | None
    lpips: float | None


@dataclass(frozen=True)
class ViewScores:
    """Scores of one held-out image, for the whole image and for the matte's bounding box extended by 8 pixels.

    In a full scene, ``covisible`` is the PSNR in dB over the pixels of the subject and of background surfaces that are
    visible in a training view (see :mod:`fourd.reconstruction.training.evaluation.covisibility`). In an object scene,
    it is None.
    """

    camera: str
    frame: int
    image: Scores
    box: Scores | None
    covisible: float | None = None


@dataclass(frozen=True)
class Evaluation:
    """Scores of all images, and their means."""

    pictures: list[ViewScores]
    image: Scores
    box: Scores | None
    covisible: float | None = None

    def to_json(self) -> dict[str, object]:
        """Return the scores as plain data for a JSON file."""
        return {
            "cameras": sorted({picture.camera for picture in self.pictures}),
            "frames": sorted({picture.frame for picture in self.pictures}),
            "image": asdict(self.image),
            "box": None if self.box is None else asdict(self.box),
            "covisible": self.covisible,
            "pictures": [asdict(picture) for picture in self.pictures],
        }


def score_view(
    prediction: NDArray[np.float32], truth: NDArray[np.float32], matte: NDArray[np.uint8], lpips: LPIPS | None
) -> tuple[Scores, Scores | None]:
    """Score an image (H, W, 3) with values in [0, 1]. Returns the scores of the whole image and of the matte's bounding
    box. The latter are None if the matte is empty."""
    predicted, expected = torch.from_numpy(prediction), torch.from_numpy(truth)
    box = mask_box(matte, margin=BOX_MARGIN_PX)
    if box is None:
        return _scores(predicted, expected, lpips), None
    top, bottom, left, right = box
    inside = (slice(top, bottom), slice(left, right))
    return _scores(predicted, expected, lpips), _scores(predicted[inside], expected[inside], lpips)


def summarize(pictures: Iterator[ViewScores] | list[ViewScores]) -> Evaluation:
    """Average the scores over images. The mean PSNR is the mean of the images' values in dB, as is usual in papers."""
    scored = list(pictures)
    boxes = [picture.box for picture in scored if picture.box is not None]
    covisible = _mean_of([picture.covisible for picture in scored])
    return Evaluation(scored, _mean([picture.image for picture in scored]), _mean(boxes) if boxes else None, covisible)


def _scores(predicted: torch.Tensor, expected: torch.Tensor, lpips: LPIPS | None) -> Scores:
    with torch.no_grad():
        large_enough = min(predicted.shape[:2]) >= MIN_SIDE_PX
        return Scores(
            psnr=float(psnr(predicted, expected)),
            ssim=float(ssim(predicted, expected)) if large_enough else None,
            lpips=float(lpips(predicted, expected)) if lpips is not None and large_enough else None,
        )


def _mean(scores: list[Scores]) -> Scores:
    return Scores(
        psnr=float(np.mean([score.psnr for score in scores])),
        ssim=_mean_of([score.ssim for score in scores]),
        lpips=_mean_of([score.lpips for score in scores]),
    )


def _mean_of(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
