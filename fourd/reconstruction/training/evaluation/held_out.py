"""The held-out score of a run: how well the scene looks from viewpoints that training does not know.

If a run has test views, they give the score when training ends. Otherwise, training leaves one camera out of the first
part of its steps, both as target view and as source view. Then it measures the score, and trains on this camera like on
all others. Leaving a camera out of single frames only would not do: frames share the models and the background, which
would learn the camera's images from the other frames.

The score is stored in the run, in the file ``checkpoints/held_out.json``. Nothing in this module needs torch.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.json_file import read_json_as

if TYPE_CHECKING:
    from fourd.reconstruction.training.config import HeldOutConfig

NAME = "held_out.json"
MIN_CAMERAS = 4
"""Minimum number of training cameras of which one is left out."""
MANY_CAMERAS = 6
"""With fewer training cameras than this number, each of them matters more, so the camera is left out for half as
long."""
NEIGHBOURS = 4
MAX_GAP_DB = 3.0
"""A larger difference between the scores of training views and of held-out views gives a warning."""
FAR_DEG = 45.0
"""If the nearest training camera is at least this angle away from a held-out one, a warning says that the cameras are
too far apart."""
_MAX_BYTES = 1 << 16
_Count = Annotated[int, Meta(ge=0, lt=1 << 53)]
_Number = Annotated[float, Meta(gt=-1e6, lt=1e6)]
_Text = Annotated[str, Meta(max_length=500)]


@dataclass(frozen=True)
class HeldOutPlan:
    """What a run leaves out.

    Attributes:
        camera: index of the camera that is left out of the first part of training, or None.
        until: fraction of the budget after which training uses the camera.
        reason: why no held-out score can be measured; empty if it can.
    """

    camera: int | None = None
    until: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class HeldOutScore:
    """A held-out score, and the score of training views at the same step. Both are the mean PSNR in dB of the same
    number of rendered images.

    Attributes:
        step: number of completed training steps.
        cameras: names of the held-out cameras.
        kind: ``test`` for test views, ``left out`` for a camera on which training continues after ``step``, and
            ``none`` if nothing can be held out.
        psnr: score of held-out views.
        training_psnr: score of training views. They are rendered without their own image as source view.
        images: number of rendered images for each of the two scores.
        part: part of the images that is compared: the whole image, or the box around the subject.
        nearest_deg: smallest angle between a held-out camera and a training camera, in degrees, as seen from the scene.
        reason: for ``none``, why nothing can be held out.
    """

    step: _Count
    cameras: tuple[_Text, ...] = ()
    kind: Literal["test", "left out", "none"] = "none"
    psnr: _Number = 0.0
    training_psnr: _Number = 0.0
    images: _Count = 0
    part: Literal["image", "box"] = "image"
    nearest_deg: _Number = 0.0
    reason: _Text = ""

    @property
    def gap_db(self) -> float:
        """Score of training views minus score of held-out views."""
        return self.training_psnr - self.psnr

    def describe(self) -> str:
        """Return the scores in words."""
        if self.kind == "none":
            return f"no held-out score: {self.reason}"
        names = ", ".join(self.cameras)
        what = f"test views {names}" if self.kind == "test" else f"camera {names} until step {self.step:,}"
        place = " (box around the subject)" if self.part == "box" else ""
        return f"held out: {what}: {self.psnr:.1f} dB; training views {self.training_psnr:.1f} dB{place}"

    def warning(self) -> str:
        """Return one line if held-out views are much worse than training views, otherwise an empty text."""
        if self.kind == "none" or self.gap_db <= MAX_GAP_DB:
            return ""
        cause = (
            f"the nearest training camera is {self.nearest_deg:.0f} degrees away, which is far: add cameras, or expect "
            "good images only near the cameras"
            if self.nearest_deg >= FAR_DEG
            else "the usual causes are errors of the calibration (fourd check CAPTURE, --refine-cameras), colours that "
            "differ between the cameras (--refine-colours), poor mattes (docs/matting.md), and training that is too "
            "long for so few cameras"
        )
        return (
            f"held-out views are {self.gap_db:.1f} dB worse than training views ({self.psnr:.1f} and "
            f"{self.training_psnr:.1f} dB), so the scene looks worse from new viewpoints than from its cameras; {cause}"
        )


def plan_held_out(
    config: HeldOutConfig, cameras: Sequence[Camera], training: Sequence[int], test: Sequence[int], focus: NDArray[Any]
) -> HeldOutPlan:
    """Choose the camera that training leaves out at first. Runs with test views leave out no other camera."""
    if test:
        return HeldOutPlan()
    if not config.on:
        return HeldOutPlan(reason="the run holds out no camera (held_out.on is false)")
    count = len(training)
    if count < MIN_CAMERAS:
        return HeldOutPlan(reason=f"with {count} cameras, none can be left out; at least {MIN_CAMERAS} are needed")
    chosen = training[best_surrounded([cameras[index] for index in training], focus)]
    return HeldOutPlan(chosen, config.until if count >= MANY_CAMERAS else config.until / 2)


def best_surrounded(cameras: Sequence[Camera], focus: NDArray[Any]) -> int:
    """Return the index of the camera that can best be replaced by the others: its neighbours are near, and they are on
    all sides. Directions are measured at the world point ``focus`` (3,)."""
    offsets = np.stack([camera.centre - focus for camera in cameras])
    rays = offsets / np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-12)
    costs = []
    for index, ray in enumerate(rays):
        others = np.delete(rays, index, axis=0)
        distances = np.linalg.norm(others - ray, axis=1)
        nearest = np.argsort(distances, kind="stable")[:NEIGHBOURS]
        # The mean offset of the neighbours is zero if they are on all sides, and large for a camera at the rim.
        asymmetry = np.linalg.norm((others[nearest] - ray).mean(axis=0))
        costs.append(round(float(asymmetry + distances[nearest].mean()), 6))
    return int(np.argmin(costs))


def save_score(score: HeldOutScore, checkpoints: Path) -> None:
    """Write the score into a run's folder of checkpoints, atomically."""
    write_text_atomically(checkpoints / NAME, json.dumps(asdict(score), allow_nan=False) + "\n")


def read_score(checkpoints: Path) -> HeldOutScore | None:
    """Read the score of a run. Returns None if the file is missing or damaged."""
    try:
        return read_json_as(checkpoints / NAME, HeldOutScore, _MAX_BYTES)
    except (OSError, ValueError, UserError):
        return None
