"""LPIPS, the learned perceptual distance (Zhang et al. 2018), version 0.1 on VGG-16.

The network is defined here instead of being imported from torchvision, because torchvision cannot be installed on some
machines. The user provides files with the weights of torchvision's VGG-16 and of the linear heads of the ``lpips``
package.
"""

from __future__ import annotations

import importlib.util
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError  # torch.load raises this error for a file that would execute code

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn import functional

from fourd.base.errors import UserError
from fourd.base.limits import require_regular

# Number of output channels of each VGG-16 convolution. A pooling layer follows each group of convolutions except the
# last one.
GROUPS = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
# Mean and standard deviation of the colours of ImageNet images, scaled to [-1, 1]. The LPIPS heads were trained on
# images from which this mean was subtracted, and which were then divided by this standard deviation.
SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
# If a side were below this length, the image would have size 0 after the four pooling layers.
MIN_SIDE_PX = 16
SUFFIXES = (".pth", ".pt", ".safetensors")
VGG_NAME = "vgg16-397923af.pth"
FIX = "pass VGG-16 weights with --lpips-weights"

# Names of the VGG-16 weights: features.0.weight in torchvision's files, and net.slice1.0.weight in a file of the whole
# LPIPS network (VGG-16 and the heads) that was saved with the lpips package.
_FEATURE_KEY = re.compile(r"(?:features|net\.slice[1-5])\.(\d+)\.(weight|bias)")
# Names of the head weights. In a file of the whole network, a head can be named lins.0 as well as lin0. The number
# after "model" is the position of the head's convolution: 1 if a dropout layer precedes it, otherwise 0.
_HEAD_KEY = re.compile(r"(?:lin|lins\.)([0-4])\.model\.[01]\.weight")


class LPIPS(nn.Module):
    """Perceptual distance between images: 0 if they are equal, near 1 if they are very different.

    The weights are frozen. The distance is differentiable with respect to the images.
    """

    shift: Tensor
    scale: Tensor

    def __init__(self, weights: Mapping[str, Tensor]) -> None:
        """Create the network. ``weights`` must have the names and shapes that :func:`expected_shapes` returns."""
        super().__init__()
        stages: list[nn.Module] = []
        inputs = 3
        for group, widths in enumerate(GROUPS):
            layers: list[nn.Module] = [] if group == 0 else [nn.MaxPool2d(2)]
            for width in widths:
                layers += [nn.Conv2d(inputs, width, 3, padding=1), nn.ReLU(inplace=True)]
                inputs = width
            stages.append(nn.Sequential(*layers))
        self.stages = nn.ModuleList(stages)
        self.heads = nn.ParameterList([weights[f"lin{group}"] for group in range(len(GROUPS))])
        self.register_buffer("shift", torch.tensor(SHIFT)[:, None, None])
        self.register_buffer("scale", torch.tensor(SCALE)[:, None, None])
        convolutions = [layer for layer in self.stages.modules() if isinstance(layer, nn.Conv2d)]
        with torch.no_grad():
            for number, layer in zip(_feature_numbers(), convolutions, strict=True):
                assert layer.bias is not None
                layer.weight.copy_(weights[f"features.{number}.weight"])
                layer.bias.copy_(weights[f"features.{number}.bias"])
        self.requires_grad_(False)
        self.eval()

    def forward(self, prediction: Tensor, target: Tensor) -> Tensor:
        """Compute the distance between two images, or the distances between corresponding images of two batches.

        Args:
            prediction: (H, W, 3) or (B, 3, H, W), images in [0, 1], floating point. Sides below 16 pixels are extended
                to 16 pixels by repeating the border, because the published network is undefined for smaller images.
            target: images of the same shape.

        Returns:
            The distance, a scalar for two images (H, W, 3), or (B,) for two batches.

        Raises:
            ValueError: the shapes differ, or are neither (H, W, 3) nor (B, 3, H, W).
        """
        if prediction.shape != target.shape:
            raise ValueError(f"target: expected the prediction's shape {tuple(prediction.shape)}, got {target.shape}")
        single = prediction.ndim == 3
        first, second = self._features(_batch(prediction)), self._features(_batch(target))
        distance = torch.zeros((), device=self.heads[0].device)
        for head, a, b in zip(self.heads, first, second, strict=True):
            difference = (_normalize(a) - _normalize(b)).square()
            distance = distance + functional.conv2d(difference, head).mean(dim=(1, 2, 3))
        return distance[0] if single else distance

    def _features(self, images: Tensor) -> list[Tensor]:
        """Compute VGG-16's activations relu1_2, relu2_2, relu3_3, relu4_3 and relu5_3 for images (B, 3, H, W) in [0,
        1]."""
        right, bottom = (max(MIN_SIDE_PX - side, 0) for side in (images.shape[3], images.shape[2]))
        if right or bottom:
            images = functional.pad(images, (0, right, 0, bottom), mode="replicate")
        features = (2 * images.to(self.heads[0].dtype) - 1 - self.shift) / self.scale
        outputs = []
        for stage in self.stages:
            features = stage(features)
            outputs.append(features)
        return outputs


def load_lpips(path: Path | None) -> LPIPS | None:
    """Load the LPIPS network with weights from files. No file is downloaded, and no code in a file is executed.

    Args:
        path: a file (.pth, .pt or .safetensors), or a folder with such files named ``vgg16*``, ``vgg.*`` or
            ``*lpips*``. The files contain VGG-16 under torchvision's names (``features.0.weight``), the linear heads
            under the names of the lpips package (``lin0.model.1.weight``), or both. If VGG-16 is missing, it is read
            from torch.hub's ``checkpoints/vgg16-397923af.pth``. If the heads are missing, they are read from the
            installed package lpips or torchmetrics. If ``path`` is None, only the default locations of VGG-16 and of
            the heads are used.

    Returns:
        The network on the CPU, or None if ``path`` is None and some weights are missing.

    Raises:
        UserError: the path does not exist, a file cannot be read, or a weight has a wrong name or shape.
    """
    files = [] if path is None else _files_of(path)
    weights: dict[str, Tensor] = {}
    for file in files:
        weights.update(_read(file))
    for prefix, candidates in (("features.", _default_vgg_files()), ("lin", _default_head_files())):
        default = next((file for file in candidates if file.is_file()), None)
        if default is not None and not any(name.startswith(prefix) for name in weights):
            weights.update(_read(default))
    missing = [name for name in expected_shapes() if name not in weights]
    if not missing:
        return LPIPS(weights)
    if path is None:
        return None
    raise UserError(
        f"{path}: expected the weights of VGG-16 (features.N.weight) and of LPIPS's heads (linN.model.1.weight), "
        f"got no weights named {_abbreviate(missing)}; put {VGG_NAME} and the lpips package's weights/v0.1/vgg.pth "
        f"in one folder and pass the folder with --lpips-weights"
    )


def expected_shapes() -> dict[str, tuple[int, ...]]:
    """Return the names and shapes of all network weights: ``features.N.weight`` and ``features.N.bias`` for the
    convolutions, with torchvision's layer numbers N, and ``linN`` for the heads."""
    shapes: dict[str, tuple[int, ...]] = {}
    inputs = 3
    widths = [width for group in GROUPS for width in group]
    for number, width in zip(_feature_numbers(), widths, strict=True):
        shapes[f"features.{number}.weight"] = (width, inputs, 3, 3)
        shapes[f"features.{number}.bias"] = (width,)
        inputs = width
    shapes.update({f"lin{group}": (1, channels[-1], 1, 1) for group, channels in enumerate(GROUPS)})
    return shapes


def _feature_numbers() -> list[int]:
    """Compute the layer numbers of the convolutions in torchvision's VGG-16, in which a ReLU follows each convolution
    and a pooling layer follows each group of convolutions."""
    numbers, number = [], 0
    for group in GROUPS:
        numbers += [number + 2 * index for index in range(len(group))]
        number += 2 * len(group) + 1
    return numbers


def _files_of(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise UserError(f"{path}: expected a file or folder with weights, got no such path; fix --lpips-weights")
    names = [entry for entry in sorted(path.iterdir()) if entry.is_file() and entry.suffix in SUFFIXES]
    files = [file for file in names if re.fullmatch(r"vgg16(?!_?bn).*|vgg|.*lpips.*", file.stem.lower())]
    if not files:
        raise UserError(
            f"{path}: expected files named vgg16*, vgg.* or *lpips* ({', '.join(SUFFIXES)}), got none; "
            f"pass the file with the weights with --lpips-weights"
        )
    return files


def _default_vgg_files() -> list[Path]:
    return [Path(torch.hub.get_dir()) / "checkpoints" / VGG_NAME]


def _default_head_files() -> list[Path]:
    """Return the paths of the LPIPS heads in the installed packages lpips and torchmetrics, without importing these
    packages."""
    inside = {"lpips": "weights/v0.1/vgg.pth", "torchmetrics": "functional/image/lpips_models/vgg.pth"}
    specs = [(importlib.util.find_spec(package), rest) for package, rest in inside.items()]
    return [Path(spec.origin).parent / rest for spec, rest in specs if spec is not None and spec.origin]


def _read(file: Path) -> dict[str, Tensor]:
    """Read LPIPS weights from a file. Returns float32 tensors by name, with the names that :func:`expected_shapes`
    lists. Raises UserError if a weight has a wrong shape."""
    shapes = expected_shapes()
    found: dict[str, Tensor] = {}
    for key, value in _load(file).items():
        name = _expected_name(key)
        if name is None:
            continue
        shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        if name not in shapes:
            raise UserError(f"{file}: expected layers of VGG-16, got the unknown layer '{key}'; {FIX}")
        if shape != shapes[name]:
            raise UserError(f"{file}: '{key}': expected shape {shapes[name]}, got {shape}; {FIX}")
        # Without a copy, the tensor would keep the file's other tensors in memory, such as the 470 MB of VGG-16's
        # classifier.
        found[name] = value.detach().to(torch.float32, copy=True)
    if not found:
        raise UserError(
            f"{file}: expected weights named like features.0.weight or lin0.model.1.weight, got none; "
            f"pass torchvision's VGG-16 or LPIPS's heads with --lpips-weights"
        )
    return found


def _load(file: Path) -> Mapping[str, Tensor]:
    try:
        require_regular(file)
        if file.suffix == ".safetensors":
            return load_file(file)
        content = torch.load(file, map_location="cpu", weights_only=True, mmap=zipfile.is_zipfile(file))
    except (OSError, SafetensorError, RuntimeError, EOFError, ValueError, UnpicklingError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise UserError(f"{file}: expected a file of tensors, got '{reason}'; download the file again") from error
    if not isinstance(content, Mapping):
        raise UserError(
            f"{file}: expected a state dict of tensors, got {type(content).__name__}; save the network's state_dict()"
        )
    return content


def _expected_name(key: str) -> str | None:
    if match := _FEATURE_KEY.fullmatch(key):
        return f"features.{match[1]}.{match[2]}"
    if match := _HEAD_KEY.fullmatch(key):
        return f"lin{match[1]}"
    return None


def _batch(images: Tensor) -> Tensor:
    if images.ndim == 3 and images.shape[2] == 3:
        return images.permute(2, 0, 1)[None]
    if images.ndim == 4 and images.shape[1] == 3:
        return images
    raise ValueError(f"prediction: expected (H, W, 3) or (B, 3, H, W), got {tuple(images.shape)}")


def _normalize(features: Tensor) -> Tensor:
    """Normalise the features (B, C, H, W) to length 1 over the channels. The clamp keeps the gradient finite at pixels
    where all channels are 0."""
    length = features.square().sum(dim=1, keepdim=True).clamp_min(1e-20).sqrt()
    return features / (length + 1e-10)


def _abbreviate(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
