"""Check of a calibration with the subject itself, for cameras whose images share too few features.

If the calibration is right, the mattes of one moment agree: the visual hull of the other views covers each of them. How
much it covers is also measured for rigs that are wrong in a known way, such as inverted poses and exchanged cameras.
The subject verifies a calibration only if all of these rigs fit plainly worse, because a compact subject in the middle
of a rig fits many of them. If one of them fits plainly better, its mistake is the likely one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.reconstruction.carving.coherence import frame_coherence
from fourd.recording.capture.layout import EXTRINSICS_NAME, sample_indices
from fourd.recording.capture.pictures.mask_source import MaskSource, frame_masks

MOMENTS = 3
MIN_CAMERAS = 3
"""Two silhouettes nearly always have a common hull."""
MIN_MATTES = 3
THRESHOLD = 128
MIN_AGREEING = 0.85
"""Fraction of a matte that the hull of the other views covers, in the median, if the calibration is right."""
POWER = 3.0
"""A rig fits plainly worse than another if the hull leaves at least this multiple of the other's part uncovered."""
FLOOR = 0.05
"""Smaller uncovered parts count as this number, because mattes have errors, too."""

MIN_SHIFT = 0.05
"""Smallest effect of mirrored principal points that is tried, as a fraction of the image width."""

Mistake = Callable[[Sequence[Camera]], list[Camera]]
Mattes = Sequence[Sequence[NDArray[np.uint8]]]


@dataclass(frozen=True)
class RigEvidence:
    """What the subject says about a calibration.

    Attributes:
        finding: whether the subject verifies the calibration, contradicts it, or does not tell.
        covered: fraction of a matte that the hull of the other views covers, in the median, or NaN if unknown.
        mattes: number of mattes that were compared. Mattes that an edge of the image cuts off are left out, because
            they also show what the other cameras do not see.
        likely: the mistake that explains the mattes much better, in words; empty if there is none.
        likely_covered: the covered fraction after this mistake is corrected.
    """

    finding: Literal["verified", "not verified", "contradicts"]
    covered: float = float("nan")
    mattes: int = 0
    likely: str = ""
    likely_covered: float = 0.0

    def __str__(self) -> str:
        if not self.mattes:
            return f"the subject does not tell: fewer than {MIN_MATTES} mattes in 3 views that no image edge cuts off"
        text = f"the hull of the other views covers {self.covered:.0%} of a matte (median of {self.mattes})"
        if self.finding == "verified":
            return f"verified by the subject: {text}, and wrong calibrations fit plainly worse"
        if self.finding == "contradicts":
            return f"contradicted by the subject: {text}; {self.likely_covered:.0%} with {self.likely}"
        return f"the subject does not tell: {text}" + (
            ", but wrong calibrations fit about as well" if self.covered >= MIN_AGREEING else ""
        )

    def require(self, path: Path) -> None:
        """Raise UserError if the subject contradicts the calibration of the capture ``path``."""
        if self.finding == "contradicts":
            raise UserError(
                f"{path / EXTRINSICS_NAME}: expected a calibration with which the mattes agree, got one with which the "
                f"hull of the other views covers {self.covered:.0%} of a matte (median of {self.mattes}), but "
                f"{self.likely_covered:.0%} with {self.likely}; correct the calibration, or continue with "
                "--accept-mattes"
            )


def check_rig(capture: MaskSource, *, verify: bool = True) -> RigEvidence:
    """Compare the mattes of a few moments, spread over the capture, with its calibration.

    Args:
        capture: cameras and mattes.
        verify: whether to measure the wrong rigs also if the calibration fits. If false, a calibration that fits is
            reported as not verified, which is much faster.
    """
    if len(capture.cameras) < MIN_CAMERAS or capture.frame_count == 0:
        return RigEvidence("not verified")
    mattes = [frame_masks(capture, frame) for frame in sample_indices(capture.frame_count, MOMENTS)]
    is_used = np.array([[not _is_cut_off(matte) for matte in moment] for moment in mattes])
    covered, count = _covered(mattes, capture.cameras, is_used)
    if count < MIN_MATTES:
        return RigEvidence("not verified")
    if covered >= MIN_AGREEING and not verify:
        return RigEvidence("not verified", covered, count)
    rigs = {name: make(capture.cameras) for name, make in MISTAKES.items()}
    wrong = {name: _covered(mattes, rig, is_used)[0] for name, rig in rigs.items() if rig}
    best = max(wrong, key=lambda name: wrong[name])
    if covered >= MIN_AGREEING and _is_plainly_worse(wrong[best], covered):
        return RigEvidence("verified", covered, count)
    if wrong[best] >= MIN_AGREEING and _is_plainly_worse(covered, wrong[best]):
        return RigEvidence("contradicts", covered, count, best, wrong[best])
    return RigEvidence("not verified", covered, count)


def _is_plainly_worse(covered: float, other: float) -> bool:
    return 1 - covered >= POWER * max(1 - other, FLOOR)


def _is_cut_off(matte: NDArray[np.uint8]) -> bool:
    edges = (matte[0], matte[-1], matte[:, 0], matte[:, -1])
    return any(bool((edge >= THRESHOLD).any()) for edge in edges)


def _covered(mattes: Mattes, cameras: Sequence[Camera], is_used: NDArray[np.bool_]) -> tuple[float, int]:
    """Return the median fraction of the used mattes that the hull of the other views covers, and their number."""
    explained = np.stack([frame_coherence(moment, cameras).explained for moment in mattes])
    values = explained[is_used & ~np.isnan(explained)]
    return (float(np.median(values)) if len(values) else 0.0), len(values)


def _inverted(cameras: Sequence[Camera]) -> list[Camera]:
    return [
        replace(camera, rotation=camera.rotation.T, translation=-camera.rotation.T @ camera.translation)
        for camera in cameras
    ]


def _mirrored(cameras: Sequence[Camera]) -> list[Camera]:
    middle = np.mean([camera.centre for camera in cameras], axis=0)
    return [replace(camera, translation=-camera.rotation @ (2 * middle - camera.centre)) for camera in cameras]


def _turned(cameras: Sequence[Camera]) -> list[Camera]:
    flip = np.diag([1.0, -1.0, -1.0])
    return [
        replace(camera, rotation=flip @ camera.rotation, translation=flip @ camera.translation) for camera in cameras
    ]


def _recentred(cameras: Sequence[Camera]) -> list[Camera]:
    """Turn the principal points by 180 degrees about the image centres. Returns an empty list if they are near the
    centres, where the mistake has no effect."""
    moved = []
    for camera in cameras:
        intrinsics = camera.intrinsics.copy()
        intrinsics[:2, 2] = np.array([camera.width, camera.height]) - intrinsics[:2, 2]
        moved.append(replace(camera, intrinsics=intrinsics))
    shifts = [
        np.abs(new.intrinsics[:2, 2] - old.intrinsics[:2, 2]).max() / old.width
        for new, old in zip(moved, cameras, strict=True)
    ]
    return moved if np.median(shifts) >= MIN_SHIFT else []


def _reversed(cameras: Sequence[Camera]) -> list[Camera]:
    return _with_poses(cameras, list(reversed(cameras)))


def _exchanged(distance: int) -> Mistake:
    def make(cameras: Sequence[Camera]) -> list[Camera]:
        others = list(cameras)
        for index in range(len(cameras) - distance):
            if index // distance % 2 == 0:
                others[index], others[index + distance] = cameras[index + distance], cameras[index]
        return _with_poses(cameras, others)

    return make


def _with_poses(cameras: Sequence[Camera], others: Sequence[Camera]) -> list[Camera]:
    return [
        replace(camera, rotation=other.rotation, translation=other.translation)
        for camera, other in zip(cameras, others, strict=True)
    ]


MISTAKES: dict[str, Mistake] = {
    "inverted poses (camera-to-world instead of world-to-camera)": _inverted,
    "camera positions on the other side of their mean": _mirrored,
    "mirrored principal points (see --centres mirrored of fourd import)": _recentred,
    "camera axes turned from OpenGL to OpenCV": _turned,
    "neighbouring cameras exchanged (check the names of the cameras)": _exchanged(1),
    "every second camera exchanged with the next but one (check the names of the cameras)": _exchanged(2),
    "cameras in reversed order (check the names of the cameras)": _reversed,
}
"""Each function corrects a mistake, in words, and also makes it, because each is its own inverse."""
