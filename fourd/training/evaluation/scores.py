"""Held-out views judged: PSNR, SSIM and LPIPS on whole images and in the matte's box."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.training.evaluation.metrics import mask_box, psnr, ssim
from fourd.training.losses.lpips import LPIPS

BOX_MARGIN_PX = 8


@dataclass(frozen=True)
class Scores:
    """Quality of one picture; psnr in dB; lpips is None without its weights."""

    psnr: float
    ssim: float | None
    lpips: float | None


@dataclass(frozen=True)
class ViewScores:
    """One held-out picture: the whole image, and the box of its matte with 8 pixels of margin."""

    camera: str
    frame: int
    image: Scores
    box: Scores | None


@dataclass(frozen=True)
class Evaluation:
    """All pictures and their means."""

    pictures: list[ViewScores]
    image: Scores
    box: Scores | None

    def to_json(self) -> dict[str, object]:
        """Plain data for a JSON file."""
        return {
            "cameras": sorted({picture.camera for picture in self.pictures}),
            "frames": sorted({picture.frame for picture in self.pictures}),
            "image": asdict(self.image),
            "box": None if self.box is None else asdict(self.box),
            "pictures": [asdict(picture) for picture in self.pictures],
        }


def score_view(
    prediction: NDArray[np.float32], truth: NDArray[np.float32], matte: NDArray[np.uint8], lpips: LPIPS | None
) -> tuple[Scores, Scores | None]:
    """Scores of a picture (H, W, 3) in [0, 1] on the whole image and in the matte's box (None when empty)."""
    predicted, expected = torch.from_numpy(prediction), torch.from_numpy(truth)
    box = mask_box(matte, margin=BOX_MARGIN_PX)
    if box is None:
        return _scores(predicted, expected, lpips), None
    top, bottom, left, right = box
    inside = (slice(top, bottom), slice(left, right))
    return _scores(predicted, expected, lpips), _scores(predicted[inside], expected[inside], lpips)


def summarize(pictures: Iterator[ViewScores] | list[ViewScores]) -> Evaluation:
    """Means over pictures: of each picture's dB, as the field's papers report."""
    kept = list(pictures)
    boxes = [picture.box for picture in kept if picture.box is not None]
    return Evaluation(kept, _mean([picture.image for picture in kept]), _mean(boxes) if boxes else None)


def _scores(predicted: torch.Tensor, expected: torch.Tensor, lpips: LPIPS | None) -> Scores:
    with torch.no_grad():
        large_enough = min(predicted.shape[:2]) >= 11
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
