"""Robust Video Matting from files: a small TorchScript network with the same interface, and invalid files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import nn

from fourd.base.errors import UserError
from fourd.recording.matting.rvm import automatic_ratio, load_rvm

Picture = NDArray[np.uint8]

# A recurrent network with the published interface. The alpha of the network is half of the red channel plus a quarter
# of the sum of red over all earlier frames.
PROGRAM = """
def forward(self, src, r1: Optional[Tensor], r2: Optional[Tensor], r3: Optional[Tensor], r4: Optional[Tensor],
            downsample_ratio: float = 1.0, segmentation_pass: bool = False):
    red = src[:, :1]
    before = torch.zeros_like(red) if r1 is None else r1
    alpha = 0.5 * red + 0.25 * before
    return [src, RESULT, before + red, alpha, alpha, alpha]
"""


def script(path: Path, result: str = "alpha", program: str = PROGRAM) -> Path:
    # Each program needs a new class, because the compiled program of a class cannot be replaced.
    module = torch.jit.script(type("Small", (nn.Module,), {})())
    module.define(program.replace("RESULT", result))
    torch.jit.save(module, str(path))
    return path


def pictures(rng: np.random.Generator, count: int, size: tuple[int, int] = (20, 30)) -> list[Picture]:
    return [rng.integers(0, 256, (*size, 3)).astype(np.uint8) for _ in range(count)]


def test_recurrent_state_is_passed_on_and_reset(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches BGR channels, a wrong scale of alpha, and recurrent state that is lost or mixed up between cameras."""
    rvm = load_rvm(script(tmp_path / "small.torchscript"), "cpu")
    frames = pictures(rng, 4)
    for _ in range(2):
        before = np.zeros(frames[0].shape[:2])
        for frame, matte in zip(frames, rvm.mattes(frames), strict=True):
            red = frame[..., 0].astype(float)
            expected = np.minimum(0.5 * red + 0.25 * before, 255)
            assert matte.dtype == np.uint8
            np.testing.assert_allclose(matte, expected, atol=0.51)
            before += red


def test_pictures_are_read_lazily(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches decoding of all frames before the first matte, and inference mode that remains enabled in the caller."""
    rvm = load_rvm(script(tmp_path / "small.pt"), "cpu")
    taken: list[int] = []

    def frames():  # type: ignore[no-untyped-def]
        for number, frame in enumerate(pictures(rng, 3)):
            taken.append(number)
            yield frame

    mattes = rvm.mattes(frames())
    next(mattes)
    assert taken == [0]
    assert not torch.is_inference_mode_enabled()


@pytest.mark.parametrize(
    ("ratio", "size", "expected"), [(None, (20, 30), 1.0), (None, (4, 1024), 0.5), (0.25, (20, 30), 0.25)]
)
def test_ratio_reaches_the_network(
    tmp_path: Path, rng: np.random.Generator, ratio: float | None, size: tuple[int, int], expected: float
) -> None:
    """Catches a downsampling ratio that the network does not get, or that is computed from the shorter image side."""
    rvm = load_rvm(script(tmp_path / "ratio.pt", "torch.full_like(alpha, downsample_ratio)"), "cpu")
    matte = next(rvm.mattes(pictures(rng, 1, size), ratio))
    assert np.abs(matte / 255.0 - expected).max() < 0.003
    assert automatic_ratio(1080, 1920) == pytest.approx(512 / 1920)


def test_bad_ratios_and_sizes_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches invalid ratios and image sizes that cause torch errors in the middle of a run."""
    rvm = load_rvm(script(tmp_path / "small.pt"), "cpu")
    for ratio in (0.0, 1.5, float("nan")):
        with pytest.raises(UserError, match=r"^--downsample: expected a ratio"):
            rvm.mattes([], ratio)
    with pytest.raises(UserError, match=r"^image 1: expected 30 x 20 pixels.*got 12 x 10"):
        list(rvm.mattes([*pictures(rng, 1), *pictures(rng, 1, (10, 12))]))


@pytest.mark.parametrize(
    ("result", "message"),
    [
        ("alpha[:, :, ::2]", "a matte of shape"),
        ("src", "a matte of shape"),
        ("alpha, alpha", "7 outputs"),
        ("alpha / 0.0", "NaN or infinite"),
        ("torch.ones([3]) + torch.ones([2])", "must match"),
    ],
)
def test_other_networks_are_refused_when_loaded(tmp_path: Path, result: str, message: str) -> None:
    """Catches a network for another task that is accepted, so that its outputs are written as mattes."""
    with pytest.raises(UserError, match=rf"small\.pt: expected .*{message}") as caught:
        load_rvm(script(tmp_path / "small.pt", result), "cpu")
    assert "\n" not in str(caught.value)


def test_network_with_other_inputs_is_refused(tmp_path: Path) -> None:
    """Catches a segmentation network with only one input that is accepted."""
    path = script(tmp_path / "one.pt", program="def forward(self, src):\n    return src\n")
    with pytest.raises(UserError, match=r"one\.pt: expected the Robust Video Matting network, got '") as caught:
        load_rvm(path, "cpu")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["broken.torchscript", "broken.pt"])
def test_broken_files_are_one_line(tmp_path: Path, rng: np.random.Generator, name: str) -> None:
    """Catches a traceback instead of a one-line error for a truncated download."""
    path = tmp_path / name
    script(path)
    whole = path.read_bytes()
    for content in (b"", rng.bytes(500), whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(UserError, match=rf"{name}: expected .*; download ") as caught:
            load_rvm(path, "cpu")
        assert "\n" not in str(caught.value)


def test_missing_files_and_other_names_are_refused(tmp_path: Path) -> None:
    """Catches an ONNX file or a folder that is accepted instead of a TorchScript file."""
    with pytest.raises(UserError, match="got no such file"):
        load_rvm(tmp_path / "none.pt")
    with pytest.raises(UserError, match="got a folder"):
        load_rvm(tmp_path)
    (tmp_path / "rvm.onnx").write_bytes(b"x")
    with pytest.raises(UserError, match=r"a TorchScript file .*\.torchscript or \.pt.*checkpoint"):
        load_rvm(tmp_path / "rvm.onnx")
