"""Mattes by networks in ONNX files: small networks with the published interfaces, and invalid files."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.matting.onnx_network import load_onnx

onnx = pytest.importorskip("onnx", reason="the package onnx makes the networks")
pytest.importorskip("onnxruntime", reason="the package onnxruntime runs the networks")

Picture = NDArray[np.uint8]
IMAGE = (1, 3, "height", "width")


def save(path: Path, nodes: list[Any], inputs: dict[str, Any], outputs: dict[str, Any], constants: Any = ()) -> Path:
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        nodes,
        "small",
        [helper.make_tensor_value_info(name, kind, shape) for name, shape in inputs.items()],
        [helper.make_tensor_value_info(name, kind, shape) for name, shape in outputs.items()],
        [onnx.numpy_helper.from_array(value, name) for name, value in dict(constants).items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.save(model, str(path))
    return path


def write_rvm(path: Path) -> Path:
    """A recurrent network. Its alpha is half of the red channel, plus a quarter of the sum of the red channels of the
    earlier frames."""
    node = onnx.helper.make_node
    states = [("r1", "r1i"), ("r2", "r2i"), ("r3", "r3i"), ("r4", "r4i")]
    nodes = [
        node("Slice", ["src", "zero", "one", "axis"], ["red"]),
        node("Mul", ["red", "half"], ["direct"]),
        node("Mul", ["r1i", "quarter"], ["earlier"]),
        node("Add", ["direct", "earlier"], ["pha"]),
        node("Add", ["red", "r1i"], ["r1o"]),
        node("Mul", ["src", "downsample_ratio"], ["fgr"]),
        *(node("Identity", [name], [f"{short}o"]) for short, name in states[1:]),
    ]
    any_shape = (1, 1, "h", "w")
    inputs = {"src": IMAGE, **dict.fromkeys(("r1i", "r2i", "r3i", "r4i"), any_shape), "downsample_ratio": (1,)}
    outputs = {"fgr": IMAGE, "pha": any_shape, **dict.fromkeys(("r1o", "r2o", "r3o", "r4o"), any_shape)}
    constants = {
        "zero": np.array([0]),
        "one": np.array([1]),
        "axis": np.array([1]),
        "half": np.float32([0.5]),
        "quarter": np.float32([0.25]),
    }
    return save(path, nodes, inputs, outputs, constants)


def write_segmentation(path: Path, factor: float = 1 / 3, image: Any = IMAGE, name: str = "image") -> Path:
    """A network whose mask is the sum of the channels times ``factor``."""
    node = onnx.helper.make_node
    nodes = [node("ReduceSum", [name, "axis"], ["sum"]), node("Mul", ["sum", "factor"], ["mask"])]
    constants = {"axis": np.array([1]), "factor": np.float32([factor])}
    return save(path, nodes, {name: image}, {"mask": (1, 1, *image[2:])}, constants)


def pictures(rng: np.random.Generator, count: int, size: tuple[int, int] = (20, 30)) -> list[Picture]:
    return [rng.integers(0, 256, (*size, 3)).astype(np.uint8) for _ in range(count)]


def test_recurrent_state_is_passed_on_and_reset(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches BGR channels, outputs in another order, and recurrent state that is lost or mixed up between cameras."""
    network = load_onnx(write_rvm(tmp_path / "rvm.onnx"))
    assert network.is_recurrent
    frames = pictures(rng, 3)
    for _ in range(2):
        before = np.zeros(frames[0].shape[:2])
        for frame, matte in zip(frames, network.mattes(frames), strict=True):
            red = frame[..., 0].astype(float)
            np.testing.assert_allclose(matte, np.minimum(0.5 * red + 0.25 * before, 255), atol=0.51)
            before += red


def test_a_segmentation_network_gives_masks(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a wrong scale of the image or the mask."""
    network = load_onnx(write_segmentation(tmp_path / "plain.onnx"))
    frame = pictures(rng, 1)[0]
    np.testing.assert_allclose(next(network.mattes([frame])), frame.mean(axis=-1), atol=0.51)


def test_a_fixed_input_size_is_kept(tmp_path: Path) -> None:
    """Catches swapped width and height of networks with a fixed input size."""
    network = load_onnx(write_segmentation(tmp_path / "fixed.onnx", image=(1, 3, 8, 16)))
    frame = np.zeros((20, 30, 3), np.uint8)
    frame[:, 15:] = 255
    matte = next(network.mattes([frame]))
    assert matte.shape == (20, 30)
    assert matte[:, :10].max() == 0
    assert matte[:, 20:].min() == 255


def test_wrong_networks_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches tracebacks of onnxruntime, masks that are logits, and a missing package without the fix."""
    node = onnx.helper.make_node
    two = {"image": IMAGE, "trimap": IMAGE}
    path = save(tmp_path / "two.onnx", [node("Add", ["image", "trimap"], ["mask"])], two, {"mask": IMAGE})
    with pytest.raises(UserError, match=r"two.onnx: expected the inputs of Robust Video Matting .*got image .*trimap"):
        load_onnx(path)
    with pytest.raises(UserError, match=r"got points tensor\(float\) \[3\]"):
        load_onnx(save(tmp_path / "p.onnx", [node("Neg", ["points"], ["mask"])], {"points": (3,)}, {"mask": (3,)}))
    frame = np.full((6, 5, 3), 200, np.uint8)
    with pytest.raises(UserError, match=r"expected mask values in \[0, 1\], got .*with a sigmoid at its end"):
        next(load_onnx(write_segmentation(tmp_path / "logits.onnx", 5.0)).mattes([frame]))
    three = save(tmp_path / "three.onnx", [node("Neg", ["image"], ["mask"])], {"image": IMAGE}, {"mask": IMAGE})
    with pytest.raises(UserError, match=r"expected one mask of shape \(1, 1, 6, 5\), got shape \(1, 3, 6, 5\)"):
        next(load_onnx(three).mattes([frame]))
    (tmp_path / "text.onnx").write_text("not a network")
    with pytest.raises(UserError, match=r"text.onnx: expected an ONNX network, got"):
        load_onnx(tmp_path / "text.onnx")
    with pytest.raises(UserError, match=r"none.onnx: expected an ONNX file, got no such file"):
        load_onnx(tmp_path / "none.onnx")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(UserError, match=r"expected the package onnxruntime .*pip install fourd\[onnx\]"):
        load_onnx(three)
