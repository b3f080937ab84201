"""Mattes of people by Robust Video Matting (Lin et al. 2022), with a network file provided by the user.

torch is imported inside functions, so that other matting methods start without it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fourd.errors import UserError

if TYPE_CHECKING:
    import torch

Picture = NDArray[np.uint8]

REDUCED_SIDE = 512
"""Longest side, pixels, of the network's coarse stage, unless a ratio is given."""
SCRIPTED = (".torchscript", ".pt")
STATES = 4
PROBE_SIDE = 64
RELEASE = "rvm_mobilenetv3_fp32.torchscript of github.com/PeterL1n/RobustVideoMatting"


class RVM:
    """The network on one device.

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
        """Generate mattes (H, W) uint8, 255 = person, of one camera's consecutive pictures (H, W, 3) uint8.

        The recurrent state passes from picture to picture and is reset at each call.

        Args:
            pictures: pictures of one size.
            ratio: in (0, 1], scale of the coarse stage; None reduces the longest side to 512 pixels. For a full
                person in a large picture a larger ratio is more accurate.

        Raises:
            UserError: if the ratio is out of range, sizes differ, or the network does not have the interface of
                Robust Video Matting.
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
                    f"picture {number}: expected {size[1]} x {size[0]} pixels, as the first has, got "
                    f"{rgb.shape[1]} x {rgb.shape[0]}; export it again at that size"
                )
            size = rgb.shape[:2]
            matte, states = self._step(rgb, states, automatic_ratio(*size) if ratio is None else ratio)
            yield matte

    def _step(
        self, rgb: Picture, states: list[torch.Tensor | None], ratio: float
    ) -> tuple[Picture, list[torch.Tensor | None]]:
        """The matte of one picture, and the recurrent state for the next."""
        import torch

        # Not around the loop above: in a generator the mode would stay enabled in the caller.
        with torch.inference_mode():
            values = torch.from_numpy(np.array(rgb)).to(self.device).permute(2, 0, 1)[None]
            try:
                found = self._network(values.to(self._dtype) / 255, *states, float(ratio))
            except torch.cuda.OutOfMemoryError as error:
                raise UserError(
                    f"{self.path}: expected memory for pictures of {rgb.shape[1]} x {rgb.shape[0]}, got too little on "
                    "the GPU; reduce the pictures or set CUDA_VISIBLE_DEVICES= to use the CPU"
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
                raise self._interface_error(f"a matte of shape {tuple(alpha.shape)} of a picture {rgb.shape}")
            if not bool(torch.isfinite(alpha).all()):
                raise UserError(
                    f"{self.path}: expected a matte in [0, 1], got NaN or infinite values; "
                    "use the file with 32-bit weights (fp32)"
                )
            matte = (alpha[0, 0].float().clamp(0, 1) * 255 + 0.5).to(torch.uint8).cpu().numpy()
        return matte, list(found[2:])

    def _interface_error(self, got: str) -> UserError:
        return UserError(f"{self.path}: expected the network of Robust Video Matting, got {got}; use {RELEASE}")


def load_rvm(path: Path | str, device: str | None = None) -> RVM:
    """Load the network from a file and run it on a small picture. Nothing is downloaded.

    A TorchScript file (.torchscript, .pt) is a program that gets executed: load only trusted files. The authors'
    checkpoints (.pth) need the source of their network, which has an incompatible licence, and are refused.

    Args:
        path: the file.
        device: "cpu" or "cuda"; None selects the GPU if there is one.

    Raises:
        UserError: if the file is missing, damaged or of another network, or the device is not available.
    """
    import torch

    path = Path(path)
    if not path.is_file():
        got = "a folder" if path.is_dir() else "no such file"
        raise UserError(f"{path}: expected the file of Robust Video Matting, got {got}; fetch {RELEASE}")
    if path.suffix not in SCRIPTED:
        raise UserError(
            f"{path}: expected a TorchScript file (.torchscript or .pt), got '{path.name}'; a checkpoint (.pth) "
            f"contains weights without the network: fetch {RELEASE}"
        )
    if device == "cuda" and not torch.cuda.is_available():
        raise UserError("--device: expected a GPU that torch supports, got none; use cpu")
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
    """Scale that reduces a picture's longest side to 512 pixels; 1 for smaller pictures."""
    return min(1.0, REDUCED_SIDE / max(height, width))


def _script(path: Path, device: str) -> torch.nn.Module:
    import torch

    try:
        return torch.jit.load(str(path), map_location=device)
    except (OSError, RuntimeError, ValueError) as error:
        raise UserError(f"{path}: expected a TorchScript network, got '{_reason(error)}'; fetch {RELEASE}") from error


def _reason(error: Exception) -> str:
    """The last line of an exception's message, which has TorchScript's cause without its traceback."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return re.sub(r"\s+", " ", lines[-1] if lines else type(error).__name__)[:160]
