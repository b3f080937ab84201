"""File format of learned models. Model files contain plain arrays only, so that loading a model executes no code."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.base.limits import require_regular
from fourd.recording.matting.motion.background_model import BackgroundModel, Deviations
from fourd.recording.matting.motion.colour_models import ColourHistogram
from fourd.recording.matting.motion.evidence import Appearance
from fourd.recording.matting.motion.mattes import MatteMaker
from fourd.recording.matting.motion.subject import Subject
from fourd.recording.matting.shadows.floor import Floor
from fourd.recording.matting.solid.resting import RestingParts

MAX_BYTES_PER_PIXEL = 64
"""Maximum total size in bytes of a model's per-pixel arrays, such as the mean background colours, divided by the number
of pixels of all cameras. Files with larger arrays are refused. The models that fourd writes have 20 bytes per pixel."""
MAX_OTHER_BYTES = 256 << 20
"""Maximum total size in bytes of a model's other arrays, such as histograms of colours."""


def save_subject(
    path: Path, subject: Subject, backgrounds: Sequence[BackgroundModel], resting: RestingParts | None = None
) -> None:
    """Write the models of the subject, of the background of all cameras, and of what rests to the file ``path``,
    atomically."""
    arrays: dict[str, Any] = {
        "box": np.zeros((0, 3)) if subject.box is None else np.stack(subject.box),
        "min_seeing": np.array(subject.min_seeing),
        "floor": np.zeros(0) if subject.floor is None else np.array([*subject.floor.normal, subject.floor.offset]),
    }
    for index, (appearance, fine) in enumerate(zip(subject.appearances, backgrounds, strict=True)):
        arrays |= {
            f"mean_{index}": fine.mean.astype(np.float16),
            f"variance_{index}": np.minimum(fine.variance, 6e4).astype(np.float16),
            f"frames_{index}": fine.frames.astype(np.float16),
            f"subject_{index}": appearance.subject.log_density,
            f"surroundings_{index}": appearance.surround.log_density,
            f"region_{index}": appearance.region,
            f"still_{index}": np.array(appearance.still_px),
            f"deviations_{index}": np.array([appearance.deviations.shaded, appearance.deviations.changed]),
        }
    arrays |= {} if resting is None else resting.arrays()
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def load_matte_maker(path: Path, cameras: Sequence[Camera]) -> MatteMaker:
    """Load a matte maker for ``cameras``. The image sizes of ``cameras`` must equal the sizes of the saved backgrounds.

    Raises:
        UserError: if the file is damaged, or belongs to cameras other than ``cameras``.
    """
    try:
        require_regular(path)
        _check_size(path, cameras)
        with np.load(path, allow_pickle=False) as arrays:
            box, min_seeing = arrays["box"], float(arrays["min_seeing"])
            if not 0 <= min_seeing <= 1:
                raise ValueError(f"a fraction of {min_seeing} of the cameras")
            floor = _floor(arrays["floor"])
            resting = RestingParts.from_arrays(arrays)
            appearances, backgrounds = [], []
            for index, camera in enumerate(cameras):
                fine = BackgroundModel(
                    *(arrays[f"{name}_{index}"].astype(np.float32) for name in ("mean", "variance", "frames"))
                )
                if fine.mean.shape != (camera.height, camera.width, 3):
                    raise ValueError("backgrounds of another size")
                backgrounds.append(fine)
                colours, surround = (ColourHistogram(arrays[f"{name}_{index}"]) for name in ("subject", "surroundings"))
                region, still_px = arrays[f"region_{index}"], float(arrays[f"still_{index}"])
                deviations = Deviations(*(float(share) for share in arrays[f"deviations_{index}"]))
                appearances.append(Appearance(fine, colours, surround, region, still_px, deviations))
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise UserError(f"{path}: expected a learned model of the subject, got '{error}'; delete the file") from error
    subject = Subject(tuple(appearances), tuple(cameras), (box[0], box[1]) if len(box) else None, min_seeing, floor)
    return MatteMaker.from_subject(subject, backgrounds, cameras, resting)


def _floor(plane: NDArray[np.floating]) -> Floor | None:
    if not len(plane):
        return None
    if plane.shape != (4,) or not np.isfinite(plane).all() or abs(float(np.linalg.norm(plane[:3])) - 1) > 1e-6:
        raise ValueError("a floor that is no plane")
    return Floor(np.asarray(plane[:3], np.float64), float(plane[3]))


def _check_size(path: Path, cameras: Sequence[Camera]) -> None:
    """Raise ValueError if the decompressed arrays would be larger than the arrays of any valid model."""
    most = MAX_OTHER_BYTES + MAX_BYTES_PER_PIXEL * sum(camera.width * camera.height for camera in cameras)
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > most:
        raise ValueError(f"arrays of {size} bytes")
