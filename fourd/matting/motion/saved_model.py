"""What was learned of a subject, on disk: arrays alone, so that loading runs no code."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.files import atomic_path
from fourd.matting.motion.background_model import Background
from fourd.matting.motion.colour_models import Colours
from fourd.matting.motion.evidence import Look
from fourd.matting.motion.mattes import Matter
from fourd.matting.motion.subject import Subject


def save_subject(path: Path, subject: Subject, backgrounds: Sequence[Background]) -> None:
    """Write the looks and the finer backgrounds, one a camera, atomically."""
    arrays: dict[str, Any] = {"box": np.zeros((0, 3)) if subject.box is None else np.stack(subject.box)}
    for index, (look, fine) in enumerate(zip(subject.looks, backgrounds, strict=True)):
        arrays |= {
            f"mean_{index}": fine.mean.astype(np.float16),
            f"variance_{index}": np.minimum(fine.variance, 6e4).astype(np.float16),
            f"frames_{index}": fine.frames.astype(np.float16),
            f"subject_{index}": look.subject.log_density,
            f"surroundings_{index}": look.surroundings.log_density,
            f"region_{index}": look.region,
            f"still_{index}": np.array(look.still_px),
        }
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def load_matter(path: Path, cameras: Sequence[Camera]) -> Matter:
    """The matter for ``cameras``, of the sizes that the backgrounds were saved in.

    Raises:
        UserError: when the file is damaged or of other cameras.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            box = arrays["box"]
            looks, backgrounds = [], []
            for index, camera in enumerate(cameras):
                fine = Background(
                    *(arrays[f"{name}_{index}"].astype(np.float32) for name in ("mean", "variance", "frames"))
                )
                if fine.mean.shape != (camera.height, camera.width, 3):
                    raise ValueError("pictures of another size")
                backgrounds.append(fine)
                of_subject, around = (Colours(arrays[f"{name}_{index}"]) for name in ("subject", "surroundings"))
                looks.append(Look(fine, of_subject, around, arrays[f"region_{index}"], float(arrays[f"still_{index}"])))
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise UserError(f"{path}: expected what was learned of the subject, got '{error}'; delete the file") from error
    subject = Subject(tuple(looks), tuple(cameras), (box[0], box[1]) if len(box) else None)
    return Matter.of(subject, backgrounds, cameras)
