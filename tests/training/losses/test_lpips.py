"""LPIPS compared with a NumPy implementation, and valid and invalid weight files. All weights are random."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from fourd.base.errors import UserError
from fourd.reconstruction.training.losses.lpips import LPIPS, expected_shapes, load_lpips

# The layers of torchvision's network as (number, input channels, output channels). None stands for a pooling layer.
PUBLISHED: list[tuple[int, int, int] | None] = [
    (0, 3, 64), (2, 64, 64), None,
    (5, 64, 128), (7, 128, 128), None,
    (10, 128, 256), (12, 256, 256), (14, 256, 256), None,
    (17, 256, 512), (19, 512, 512), (21, 512, 512), None,
    (24, 512, 512), (26, 512, 512), (28, 512, 512),
]  # fmt: skip
TAPS = (2, 7, 14, 21, 28)


def published_weights(seed: int) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Random weights of the VGG-16 features and the LPIPS heads. The weights have the names that torchvision and the
    lpips package use."""
    generator = torch.Generator().manual_seed(seed)
    features: dict[str, Tensor] = {}
    for layer in PUBLISHED:
        if layer is not None:
            number, inputs, outputs = layer
            spread = (2 / (9 * inputs)) ** 0.5
            features[f"features.{number}.weight"] = torch.randn(outputs, inputs, 3, 3, generator=generator) * spread
            features[f"features.{number}.bias"] = torch.randn(outputs, generator=generator) * 0.1
    widths = (64, 128, 256, 512, 512)
    heads = {
        f"lin{i}.model.1.weight": torch.rand(1, width, 1, 1, generator=generator) for i, width in enumerate(widths)
    }
    return features, heads


@pytest.fixture(scope="module")
def weights() -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    return published_weights(seed=5)


@pytest.fixture(scope="module")
def folder(weights: tuple[dict[str, Tensor], dict[str, Tensor]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of downloaded weights: one .pth file and one .safetensors file."""
    path = tmp_path_factory.mktemp("weights")
    save_file(weights[0], path / "vgg16-397923af.safetensors")
    torch.save(weights[1], path / "vgg.pth")
    return path


@pytest.fixture(scope="module")
def network(folder: Path) -> LPIPS:
    loaded = load_lpips(folder)
    assert loaded is not None
    return loaded


@pytest.fixture(autouse=True)
def empty_caches(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Hide weights that are installed on the machine, so that tests do not depend on them."""
    monkeypatch.setattr("torch.hub.get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)


def plain_distance(
    image: np.ndarray, other: np.ndarray, features: dict[str, Tensor], heads: dict[str, Tensor]
) -> float:
    """LPIPS of images (H, W, 3) in [0, 1], implemented in float64 NumPy with loops over windows."""

    def taps(picture: np.ndarray) -> list[np.ndarray]:
        x = (picture.astype(np.float64) * 2 - 1 - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]
        outputs = []
        for layer in PUBLISHED:
            if layer is None:
                height, width = x.shape[0] // 2, x.shape[1] // 2
                x = x[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1).max(axis=(1, 3))
                continue
            kernel = features[f"features.{layer[0]}.weight"].double().numpy()
            padded = np.pad(x, ((1, 1), (1, 1), (0, 0)))
            total = np.zeros((*x.shape[:2], layer[2])) + features[f"features.{layer[0]}.bias"].double().numpy()
            for i in range(3):
                for j in range(3):
                    total += padded[i : i + x.shape[0], j : j + x.shape[1]] @ kernel[:, :, i, j].T
            x = np.maximum(total, 0)
            if layer[0] in TAPS:
                outputs.append(x)
        return outputs

    distance = 0.0
    for index, (a, b) in enumerate(zip(taps(image), taps(other), strict=True)):
        unit_a = a / (np.linalg.norm(a, axis=2, keepdims=True) + 1e-10)
        unit_b = b / (np.linalg.norm(b, axis=2, keepdims=True) + 1e-10)
        head = heads[f"lin{index}.model.1.weight"].double().numpy().ravel()
        distance += float((((unit_a - unit_b) ** 2) @ head).mean())
    return distance


def test_equals_a_numpy_implementation(
    network: LPIPS, weights: tuple[dict[str, Tensor], dict[str, Tensor]], rng: np.random.Generator
) -> None:
    """Catches a wrong layer, a wrong shift, scale or input range of the images, and swapped height and width."""
    image, other = (rng.random((37, 22, 3)).astype(np.float32) for _ in range(2))
    found = float(network(torch.from_numpy(image), torch.from_numpy(other)))
    assert found == pytest.approx(plain_distance(image, other, *weights), rel=1e-4)


def test_names_and_shapes_are_as_published(weights: tuple[dict[str, Tensor], dict[str, Tensor]]) -> None:
    """Catches a wrong layer number in the table that is used for the validation of files."""
    given = {
        name.replace(".model.1.weight", ""): tuple(value.shape) for name, value in (weights[0] | weights[1]).items()
    }
    assert expected_shapes() == given


def test_batches_are_compared_pair_by_pair(network: LPIPS, rng: np.random.Generator) -> None:
    """Catches an LPIPS that is averaged over the batch, and images (H, W, 3) that are read as (3, H, W)."""
    first, second = (torch.from_numpy(rng.random((2, 3, 20, 24)).astype(np.float32)) for _ in range(2))
    batched = network(first, second)
    separate = [network(a.permute(1, 2, 0), b.permute(1, 2, 0)) for a, b in zip(first, second, strict=True)]
    assert batched.shape == (2,)
    assert separate[0].shape == ()
    torch.testing.assert_close(batched, torch.stack(separate), rtol=1e-5, atol=1e-6)
    assert float(network(first, first).abs().max()) == 0


@pytest.mark.parametrize("size", [(1, 1), (5, 40), (15, 15)])
def test_small_images_are_extended_by_their_border(network: LPIPS, size: tuple[int, int]) -> None:
    """Catches a crash on small images, for which a pooling layer has an empty output."""
    torch.manual_seed(0)
    image, other = torch.rand(*size, 3), torch.rand(*size, 3)
    rows, columns = (torch.arange(max(side, 16)).clamp_max(side - 1) for side in size)
    expected = network(image[rows][:, columns], other[rows][:, columns])
    torch.testing.assert_close(network(image, other), expected)


def test_gradients_reach_the_image_alone(network: LPIPS) -> None:
    """Catches trainable weights, and an infinite gradient where all channels are 0, because of the square root."""
    dark = {name: value.clone() for name, value in network.state_dict().items()}
    for name in dark:
        if name.endswith("bias"):
            dark[name] -= 100.0
    clone = LPIPS({name: torch.zeros(shape) for name, shape in expected_shapes().items()})
    clone.load_state_dict(dark)
    for judge in (network, clone):
        image = torch.rand(18, 18, 3, requires_grad=True)
        judge(image, torch.rand(18, 18, 3)).backward()
        assert image.grad is not None
        assert torch.isfinite(image.grad).all()
        assert all(parameter.grad is None for parameter in judge.parameters())
    image = torch.rand(18, 18, 3, requires_grad=True)
    network(image, torch.rand(18, 18, 3)).backward()
    assert image.grad is not None
    assert image.grad.abs().max() > 0


def test_wrong_image_shapes_are_refused(network: LPIPS) -> None:
    with pytest.raises(ValueError, match=r"expected \(H, W, 3\) or \(B, 3, H, W\)"):
        network(torch.rand(3, 20, 20), torch.rand(3, 20, 20))
    with pytest.raises(ValueError, match="prediction's shape"):
        network(torch.rand(20, 20, 3), torch.rand(20, 21, 3))


def test_one_file_may_contain_the_whole_network_under_the_package_s_names(
    weights: tuple[dict[str, Tensor], dict[str, Tensor]], network: LPIPS, tmp_path: Path
) -> None:
    """Catches an error for a valid file, which is a half-precision state dict of the lpips network with additional
    keys."""
    starts = (0, 4, 9, 16, 23, 30)
    whole: dict[str, Tensor] = {"scaling_layer.shift": torch.zeros(1, 3, 1, 1)}
    for name, value in weights[0].items():
        number = int(name.split(".")[1])
        part = max(i for i in range(5) if starts[i] <= number) + 1
        whole[name.replace("features", f"net.slice{part}")] = value.half()
    whole |= weights[1]
    torch.save(whole, tmp_path / "everything.pth")
    loaded = load_lpips(tmp_path / "everything.pth")
    assert loaded is not None
    for name, value in network.state_dict().items():
        torch.testing.assert_close(loaded.state_dict()[name], value, rtol=1e-2, atol=1e-3)


def test_default_locations_are_found(
    weights: tuple[dict[str, Tensor], dict[str, Tensor]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a search that finds weights only if both weight files are in one folder, or that imports the lpips
    package."""
    assert load_lpips(None) is None
    checkpoints = tmp_path / "hub" / "checkpoints"
    checkpoints.mkdir(parents=True)
    # The file of torchvision has an older torch format, which cannot be memory-mapped.
    torch.save(weights[0], checkpoints / "vgg16-397923af.pth", _use_new_zipfile_serialization=False)
    assert load_lpips(None) is None
    package = tmp_path / "site" / "lpips"
    (package / "weights" / "v0.1").mkdir(parents=True)
    (package / "__init__.py").write_text("raise RuntimeError('imported')")
    torch.save(weights[1], package / "weights" / "v0.1" / "vgg.pth")
    monkeypatch.undo()
    monkeypatch.setattr("torch.hub.get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    assert load_lpips(None) is not None
    assert load_lpips(package / "weights" / "v0.1" / "vgg.pth") is not None


def test_invalid_weights_are_one_line(
    weights: tuple[dict[str, Tensor], dict[str, Tensor]], folder: Path, tmp_path: Path
) -> None:
    """Catches error messages for invalid weights that do not name the file, or have several lines."""
    cases: dict[str, tuple[Path, str]] = {}
    cases["missing"] = (tmp_path / "no.pth", "expected a file or folder with weights")
    (tmp_path / "empty").mkdir()
    cases["empty folder"] = (tmp_path / "empty", "expected files named vgg16")
    cases["one part"] = (folder / "vgg.pth", "got no weights named features.0.weight")
    alex = {"lin0.model.1.weight": torch.rand(1, 64, 1, 1), "lin1.model.1.weight": torch.rand(1, 192, 1, 1)}
    torch.save(alex, tmp_path / "alex.pth")
    cases["another network"] = (tmp_path / "alex.pth", r"'lin1.model.1.weight': expected shape \(1, 128, 1, 1\), got")
    save_file({"features.1.weight": torch.rand(3)}, tmp_path / "bn.safetensors")
    cases["another layout"] = (tmp_path / "bn.safetensors", "got the unknown layer 'features.1.weight'")
    save_file({"other": torch.rand(3)}, tmp_path / "other.safetensors")
    cases["unknown names"] = (tmp_path / "other.safetensors", "expected weights named like features.0.weight")
    (tmp_path / "cut.pth").write_bytes((folder / "vgg.pth").read_bytes()[:3000])
    cases["truncated"] = (tmp_path / "cut.pth", "expected a file of tensors")
    (tmp_path / "text.safetensors").write_text("<html>not found</html>")
    cases["a web page"] = (tmp_path / "text.safetensors", "expected a file of tensors")
    torch.save([torch.rand(3)], tmp_path / "list.pth")
    cases["no state dict"] = (tmp_path / "list.pth", "expected a state dict")
    for label, (path, message) in cases.items():
        with pytest.raises(UserError, match=message) as caught:
            load_lpips(path)
        assert str(path) in str(caught.value), label
        assert "\n" not in str(caught.value), label


class Attack:
    """An object whose unpickling calls os.system."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[str]]:
        import os

        return os.system, (f"touch {self.target}",)


@pytest.mark.parametrize("zipped", [True, False])
def test_a_file_that_would_execute_code_is_refused(zipped: bool, tmp_path: Path) -> None:
    """Catches torch.load without weights_only, which would execute code in the file."""
    torch.save(
        {"lin0.model.1.weight": Attack(tmp_path / "ran")}, tmp_path / "evil.pth", _use_new_zipfile_serialization=zipped
    )
    with pytest.raises(UserError, match="expected a file of tensors"):
        load_lpips(tmp_path / "evil.pth")
    assert not (tmp_path / "ran").exists()
