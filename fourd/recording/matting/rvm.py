"""Mattes of people by Robust Video Matting (Lin et al. 2022), with a network file that the user provides.

torch is imported inside functions, so that other matting methods start without torch.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError

if TYPE_CHECKING:
    import torch

Picture = NDArray[np.uint8]

REDUCED_SIDE = 512
"""Longest side, in pixels, of the reduced image in the network's coarse stage, unless the caller sets the reduction
ratio."""
SCRIPTED = (".torchscript", ".pt")
STATES = 4
PROBE_SIDE = 64
RELEASE = "rvm_mobilenetv3_fp32.torchscript of github.com/PeterL1n/RobustVideoMatting"


class RVM:
    """The network of Robust Video Matting on one device.

    Attributes:
        path: file of the network.
        device: "cpu" or "cuda".
    """

    def __init__(self, network: torch.nn.Module, path: Path, device: str, dtype: torch.dtype) -> None:
        self.path = path
        self.device = device
        self._network = network
        self._dtype = dtype

    def mattes(self, pictures: Iterable[Picture], ratio: float | None = None) -> Iterator[Picture]:
        """Yield the mattes (H, W) uint8, 255 = person, of one camera's consecutive images.

        The network's recurrent state is passed from image to image and is reset at each call.

        Args:
            pictures: images (H, W, 3) uint8, all of one size.
            ratio: scale of the image in the network's coarse stage, in (0, 1], or None to reduce the longest side to
                512 pixels. If a large image shows a whole person, high ratios give more accurate mattes than low ones.

        Raises:
            UserError: if the ratio is out of range, the images' sizes differ, or the network does not have the
                interface of Robust Video Matting.
        """
        if ratio is not None and not 0 < ratio <= 1:
            raise UserError(f"--downsample: expected a ratio above 0 and at most 1, got {ratio:g}")
        return self._mattes(pictures, ratio)

    def _mattes(self, pictures: Iterable[Picture], ratio: float | None) -> Iterator[Picture]:
        states: list[torch.Tensor | None] = [None] * STATES
        size: tuple[int, ...] | None = None
        for number, rgb in enumerate(pictures):
            if size is not None and rgb.shape[:2] != size:
                raise UserError(
                    f"image {number}: expected {size[1]} x {size[0]} pixels like the first image, got "
                    f"{rgb.shape[1]} x {rgb.shape[0]}; export the image again at the expected size"
                )
            size = rgb.shape[:2]
            matte, states = self._step(rgb, states, automatic_ratio(*size) if ratio is None else ratio)
            yield matte

    def _step(
        self, rgb: Picture, states: list[torch.Tensor | None], ratio: float
    ) -> tuple[Picture, list[torch.Tensor | None]]:
        """Compute the matte of one image, and the recurrent state for the next image."""
        import torch

        # Inference mode is not enabled in the generator _mattes, because it would then stay enabled in the caller after
        # each yield.
        with torch.inference_mode():
            values = torch.from_numpy(np.array(rgb)).to(self.device).permute(2, 0, 1)[None]
            try:
                found = self._network(values.to(self._dtype) / 255, *states, float(ratio))
            except torch.cuda.OutOfMemoryError as error:
                raise UserError(
                    f"{self.path}: expected enough GPU memory for images of {rgb.shape[1]} x {rgb.shape[0]} pixels, "
                    "got too little; reduce the images or set CUDA_VISIBLE_DEVICES= to use the CPU"
                ) from error
            except (RuntimeError, TypeError, ValueError) as error:
                raise self._interface_error(f"'{_reason(error)}'") from error
            if not isinstance(found, (tuple, list)) or len(found) != 2 + STATES:
                count = len(found) if isinstance(found, (tuple, list)) else 1
                raise self._interface_error(f"{count} outputs instead of {2 + STATES}")
            if not all(isinstance(part, torch.Tensor) for part in found):
                raise self._interface_error("outputs that are not tensors")
            alpha = found[1]
            if tuple(alpha.shape) != (1, 1, *rgb.shape[:2]):
                raise self._interface_error(f"a matte of shape {tuple(alpha.shape)} for an image of shape {rgb.shape}")
            if not bool(torch.isfinite(alpha).all()):
                raise UserError(
                    f"{self.path}: expected matte values in [0, 1], got NaN or infinite values; "
                    "use the network file with 32-bit weights (fp32)"
                )
            matte = (alpha[0, 0].float().clamp(0, 1) * 255 + 0.5).to(torch.uint8).cpu().numpy()
        return matte, list(found[2:])

    def _interface_error(self, got: str) -> UserError:
        return UserError(f"{self.path}: expected the Robust Video Matting network, got {got}; use {RELEASE}")


def load_rvm(path: Path | str, device: str | None = None) -> RVM:
    """Load the network from a local file and run it on a small image as a test.

    Loading a TorchScript file (.torchscript, .pt) executes its code, so load only trusted files. Checkpoints (.pth)
    are refused, because they contain weights only. fourd does not include the network's source code, because the code's
    licence is incompatible with fourd's licence.

    Args:
        path: TorchScript file.
        device: "cpu" or "cuda", or None to select the GPU if there is one.

    Raises:
        UserError: if the file is missing or damaged, if it contains a network other than Robust Video Matting, or if
            the device is not available.
    """
    import torch

    path = Path(path)
    if not path.is_file():
        got = "a folder" if path.is_dir() else "no such file"
        raise UserError(f"{path}: expected the Robust Video Matting network file, got {got}; download {RELEASE}")
    if path.suffix not in SCRIPTED:
        raise UserError(
            f"{path}: expected a TorchScript file (.torchscript or .pt), got '{path.name}'; a checkpoint (.pth) "
            f"contains weights without the network; download {RELEASE}"
        )
    if device == "cuda" and not torch.cuda.is_available():
        raise UserError("--device: expected a GPU that torch supports, got none; use --device cpu")
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    network = _script(path, device).to(device).eval()
    # A frozen TorchScript network stores its weights as constants, so parameters() is empty.
    dtype = next((weight.dtype for weight in network.parameters()), torch.float32)
    rvm = RVM(network, path, device, dtype)
    probe = np.zeros((PROBE_SIDE, PROBE_SIDE, 3), np.uint8)
    for _ in rvm.mattes([probe, probe], ratio=0.5):
        pass
    return rvm


def automatic_ratio(height: int, width: int) -> float:
    """Return the scale that reduces an image's longest side to 512 pixels, or 1 for smaller images."""
    return min(1.0, REDUCED_SIDE / max(height, width))


def _script(path: Path, device: str) -> torch.nn.Module:
    import torch

    try:
        return torch.jit.load(str(path), map_location=device)
    except (OSError, RuntimeError, ValueError) as error:
        raise UserError(
            f"{path}: expected a TorchScript network, got '{_reason(error)}'; download {RELEASE}"
        ) from error


def _reason(error: Exception) -> str:
    """Return the last line of an exception's message. In TorchScript errors, the last line is the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return re.sub(r"\s+", " ", lines[-1] if lines else type(error).__name__)[:160]
