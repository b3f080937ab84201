"""Tests that scripts for nvdiffrast.torch run with fourd.rendering.nvdiffrast after only their import line is
changed."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest
import torch

import fourd.rendering.nvdiffrast as dr

SCRIPTS = Path(__file__).parent / "scripts"


def run(name: str, folder: Path) -> dict[str, Any]:
    """Replace the import line of a script, run the script and return its results."""
    text = (SCRIPTS / f"{name}.py").read_text(encoding="utf-8")
    line = "import nvdiffrast.torch as dr\n"
    assert text.count(line) == 1
    copy = folder / f"{name}.py"
    copy.write_text(text.replace(line, "import fourd.rendering.nvdiffrast as dr\n"), encoding="utf-8")
    return runpy.run_path(str(copy))["result"]


def test_triangle(tmp_path: Path) -> None:
    """Catches images that are upside down, and a context that is not accepted."""
    result = run("triangle", tmp_path)
    assert result["covered"] == pytest.approx(0.32, abs=0.02)
    assert result["top_left_blue"] > 0.9


def test_cube_is_fitted_by_gradient_descent(tmp_path: Path) -> None:
    """Catches missing gradients of silhouettes, without which the vertices do not move to their true positions."""
    result = run("cube", tmp_path)
    assert result["error_before"] > 0.2
    assert result["error_after"] < 0.5 * result["error_before"]


def test_texture_with_mip_levels_is_fitted(tmp_path: Path) -> None:
    """Catches arguments of texture that are passed in the wrong order, and mip levels that change the image."""
    result = run("texture", tmp_path)
    assert result["loss_after"] < 0.05 * result["loss_before"]
    assert result["mip_difference"] == pytest.approx(0, abs=1e-6)
    assert result["log_level"] == 2


def test_depth_peeling_with_ranges(tmp_path: Path) -> None:
    """Catches layers in the wrong order, and ranges that the peeler ignores."""
    result = run("peeling", tmp_path)
    nearest_first = [[4, 4], [6, 0], [2, 0], [0, 0]]
    assert [[(number + 1) // 2 for number in ids] for ids in result["order"]] == [
        [(number + 1) // 2 for number in ids] for ids in nearest_first
    ]
    assert result["alpha"] == [0.875, 0.5]


def test_wrong_contexts_and_levels_are_named() -> None:
    """Catches a call without a context, in which each argument would be passed as the previous parameter."""
    pos, tri = torch.zeros(1, 3, 4), torch.zeros(1, 3, dtype=torch.int32)
    with pytest.raises(TypeError, match="glctx: expected a RasterizeCudaContext or a RasterizeGLContext as the first"):
        dr.rasterize(pos, tri, (4, 4), (4, 4))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"resolution: expected \[height, width\], got \[4\]"):
        dr.rasterize(dr.RasterizeCudaContext(), pos, tri, [4])
    with pytest.raises(ValueError, match="mode: expected 'automatic' or 'manual', got 'fast'"):
        dr.RasterizeGLContext(mode="fast")
    with pytest.raises(ValueError, match="level: expected 0 to 3, got 7"):
        dr.set_log_level(7)


def test_without_output_db_the_derivatives_are_empty() -> None:
    """Catches a context whose option is ignored, which costs time and memory."""
    pos = torch.tensor([[[-1.0, -1, 0, 1], [1, -1, 0, 1], [-1, 1, 0, 1]]])
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    _, rast_db = dr.rasterize(dr.RasterizeGLContext(output_db=False), pos, tri, (4, 5))
    assert rast_db.shape == (1, 4, 5, 0)
