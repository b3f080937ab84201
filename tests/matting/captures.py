"""A small capture without masks, made from the ball capture. The ground-truth mattes are in a separate folder."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from PIL import Image

from fourd.recording.capture import Capture, open_capture
from tests.captures import write_ball_capture


def write_capture_without_masks(folder: Path, *, frames: int = 8, size: int = 96, cameras: int = 8) -> Path:
    """Write a ball capture without masks into ``folder``. The true masks are written to truth/masks in the same
    folder."""
    capture = write_ball_capture(folder / "capture", cameras=cameras, frames=frames, size=size)
    shutil.move(capture / "masks", folder / "truth" / "masks")
    return capture


def write_video(path: Path, pictures: Sequence[Path]) -> None:
    """Write a video of the images ``pictures`` at 30 frames per second."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "6", "g": "4"})
        with Image.open(pictures[0]) as first:
            stream.width, stream.height = first.size
        stream.pix_fmt = "yuv420p"
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(np.array(Image.open(picture).convert("RGB")), format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def matte_iou(made: Capture, truth: Path) -> np.ndarray:
    """Intersection over union (IoU) between the mattes of a capture and the true masks, (C, F) for C cameras and F
    frames."""
    shutil.copytree(made.path / "images", truth / "images", dirs_exist_ok=True)
    for name in ("intri.yml", "extri.yml"):
        shutil.copy(made.path / name, truth / name)
    true = open_capture(truth)
    table = np.zeros((len(made.names), made.frame_count))
    for camera in range(len(made.names)):
        for frame in range(made.frame_count):
            a, b = made.mask(camera, frame) > 127, true.mask(camera, frame) > 127
            table[camera, frame] = (a & b).sum() / max(1, (a | b).sum())
    return table
