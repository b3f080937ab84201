"""Mattes by a network in an ONNX file, with onnxruntime: Robust Video Matting, or a segmentation network.

onnxruntime is an optional package and is imported inside functions. Unlike TorchScript files, ONNX files contain no
code.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.limits import require_regular
from fourd.recording.matting.rvm import automatic_ratio

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

Picture = NDArray[np.uint8]

RVM_INPUTS = ("src", "r1i", "r2i", "r3i", "r4i", "downsample_ratio")
RVM_OUTPUTS = ("fgr", "pha", "r1o", "r2o", "r3o", "r4o")
EXPECTED = (
    "expected the inputs of Robust Video Matting (src, r1i to r4i, downsample_ratio) or one image input (1, 3, H, W) "
    "of 32-bit floats"
)
TOLERANCE = 0.01


class OnnxNetwork:
    """A network in an ONNX file. Images are RGB in [0, 1], and masks are in [0, 1] with 1 = subject.

    Attributes:
        path: file of the network.
        is_recurrent: whether the network has the interface of Robust Video Matting.
    """

    def __init__(self, session: InferenceSession, path: Path) -> None:
        self.path = path
        self._session = session
        inputs = {each.name: each for each in session.get_inputs()}
        outputs = [each.name for each in session.get_outputs()]
        self.is_recurrent = set(inputs) == set(RVM_INPUTS) and set(RVM_OUTPUTS) <= set(outputs)
        if not self.is_recurrent and not _is_image_network(list(inputs.values())):
            found = ", ".join(f"{each.name} {each.type} {each.shape}" for each in inputs.values()) or "no inputs"
            raise UserError(f"{path}: {EXPECTED}, got {found}; export the network with one of these interfaces")
        self._image = "src" if self.is_recurrent else next(iter(inputs))
        self._mask = "pha" if self.is_recurrent else outputs[0]
        sides = inputs[self._image].shape[2:]
        self._size = (sides[1], sides[0]) if all(isinstance(side, int) for side in sides) else None

    def mattes(self, pictures: Iterable[Picture]) -> Iterator[Picture]:
        """Yield the mattes (H, W) uint8, 255 = subject, of one camera's consecutive images (H, W, 3) uint8.

        A recurrent state is passed from image to image and is reset at each call. If the network has a fixed input
        size, the images are resized to this size, and the mattes are resized to the size of the images.

        Raises:
            UserError: if the network fails on an image, or its mask has a wrong shape or values outside [0, 1].
        """
        states = [np.zeros((1, 1, 1, 1), np.float32)] * 4
        for rgb in pictures:
            size = (rgb.shape[1], rgb.shape[0])
            reduced = rgb if self._size in (None, size) else cv2.resize(rgb, self._size, interpolation=cv2.INTER_AREA)
            values = np.ascontiguousarray(reduced.transpose(2, 0, 1)[None], np.float32) / np.float32(255)
            feed: dict[str, Any] = {self._image: values}
            if self.is_recurrent:
                feed |= dict(zip(RVM_INPUTS[1:5], states, strict=True))
                feed["downsample_ratio"] = np.array([automatic_ratio(*rgb.shape[:2])], np.float32)
                mask, *states = self._run((self._mask, *RVM_OUTPUTS[2:]), feed)
            else:
                mask = self._run((self._mask,), feed)[0]
            yield self._to_matte(mask, values.shape[2:], size)

    def _run(self, outputs: tuple[str, ...], feed: dict[str, Any]) -> list[NDArray[np.float32]]:
        try:
            return list(self._session.run(outputs, feed))
        except Exception as error:  # onnxruntime's exceptions have no common base class except Exception
            raise UserError(
                f"{self.path}: expected a network that runs on images, got '{_reason(error)}'; {EXPECTED}"
            ) from error

    def _to_matte(self, mask: NDArray[np.float32], shape: tuple[int, ...], size: tuple[int, int]) -> Picture:
        if mask.size != shape[0] * shape[1] or mask.shape[-2:] != shape:
            raise UserError(
                f"{self.path}: expected one mask of shape {(1, 1, *shape)}, got shape {mask.shape}; export the network "
                "with the mask as its first output"
            )
        plane = np.asarray(mask, np.float32).reshape(shape)
        if not (np.isfinite(plane).all() and plane.min() > -TOLERANCE and plane.max() < 1 + TOLERANCE):
            raise UserError(
                f"{self.path}: expected mask values in [0, 1], got {plane.min():.3g} to {plane.max():.3g}; export the "
                "network with a sigmoid at its end"
            )
        if plane.shape != (size[1], size[0]):
            plane = np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR), np.float32)
        return (np.clip(plane, 0, 1) * 255 + 0.5).astype(np.uint8)


def _is_image_network(inputs: Sequence[Any]) -> bool:
    """Return whether a network's only input is an image (1, 3, H, W) of 32-bit floats."""
    if len(inputs) != 1 or inputs[0].type != "tensor(float)" or len(inputs[0].shape) != 4:
        return False
    return inputs[0].shape[1] == 3 or not isinstance(inputs[0].shape[1], int)


def load_onnx(path: Path | str) -> OnnxNetwork:
    """Load a network from an ONNX file.

    The network runs on the GPU if onnxruntime supports the GPU, and otherwise on the CPU.

    Raises:
        UserError: if onnxruntime is not installed, the file is missing or damaged, or the network's inputs are not
            supported.
    """
    path = Path(path)
    if not path.is_file():
        got = "a folder" if path.is_dir() else "no such file"
        raise UserError(f"{path}: expected an ONNX file, got {got}; check the path of --onnx")
    require_regular(path)
    try:
        import onnxruntime
    except ImportError as error:
        raise UserError(
            f"{path}: expected the package onnxruntime for ONNX files, got none; install it with: "
            "pip install fourd[onnx]"
        ) from error
    try:
        session = onnxruntime.InferenceSession(str(path), providers=onnxruntime.get_available_providers())
    except Exception as error:  # onnxruntime's exceptions have no common base class except Exception
        raise UserError(
            f"{path}: expected an ONNX network, got '{_reason(error)}'; export the network again"
        ) from error
    return OnnxNetwork(session, path)


def _reason(error: Exception) -> str:
    """Return the first line of an exception's message."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return re.sub(r"\s+", " ", lines[0] if lines else type(error).__name__)[:160]
