"""The command fourd fit-triangles on a small synthetic capture: results, Ctrl-C and bad input."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

import fourd.reconstruction.meshes.triangle_fitting.frame as frame
from fourd.cli.main import main
from fourd.reconstruction.meshes.triangle_fitting.frame import fit_frame
from fourd.reconstruction.meshes.triangle_fitting.settings import TriangleSettings
from fourd.reconstruction.training.cameras.selection import DataSelection, open_run_views

SMALL = ["--triangles", "1500", "--cells", "24"]


def fit(capture: Path, **settings: object) -> frame.FittedFrame:
    views = open_run_views(capture, DataSelection(None, ("02",), "0:1", 1.0))
    return fit_frame(views, TriangleSettings(**{"triangles": 1500, "cells": 24} | settings))  # type: ignore[arg-type]


def box_psnr(result: frame.FittedFrame) -> tuple[float, float]:
    assert result.soft is not None
    assert result.opaque is not None
    assert result.soft.box is not None
    assert result.opaque.box is not None
    return result.soft.box.psnr, result.opaque.box.psnr


def test_a_fit_improves_the_unseen_view(ball_capture: Path) -> None:
    """Catches gradients of the wrong sign, and a mesh that is worse than the soft triangles."""
    short = box_psnr(fit(ball_capture, max_steps=6, interval=100))
    long = box_psnr(fit(ball_capture, max_steps=150, interval=20))
    assert long[0] > short[0] + 1
    assert long[1] > short[1] + 0.5
    assert long[1] > 22


def test_a_fit_without_hardening_is_scored(ball_capture: Path) -> None:
    """Catches soft triangles that are not scored if the fit ends in the soft phase."""
    soft, opaque = box_psnr(fit(ball_capture, max_steps=4, soft_share=1.0, hard_share=1.0))
    assert 5 < soft < 40
    assert 5 < opaque < 40


def test_equal_seeds_give_equal_meshes(ball_capture: Path) -> None:
    """Catches random numbers without a seed."""
    first, second, other = (fit(ball_capture, max_steps=12, interval=4, seed=seed).mesh for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.xyz, second.xyz)
    np.testing.assert_array_equal(first.rgb, second.rgb)
    assert first.xyz.shape != other.xyz.shape or not np.array_equal(first.xyz, other.xyz)


@pytest.mark.parametrize("name", ["ball.ply", "ball.glb"])
def test_the_mesh_is_closed(ball_capture: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches files that other programs cannot open, open meshes, and a command that ignores its limit."""
    out = tmp_path / "new" / name
    words = ["fit-triangles", str(ball_capture), "-o", str(out), "--frame", "1", "--max-steps", "20", *SMALL]
    assert main([*words, "--test-views", "02,05"]) == 0
    printed = capsys.readouterr()
    assert "after 20 steps" in printed.err
    assert "opaque mesh" in printed.out
    mesh = trimesh.load(out, process=False, force="mesh")
    assert mesh.is_watertight
    assert f"{len(mesh.faces):,} triangles" in printed.err
    if name == "ball.ply":
        assert mesh.visual.vertex_colors[:, :3].std() > 5


def test_separate_triangles_share_no_vertices(ball_capture: Path, tmp_path: Path) -> None:
    """Catches an option --separate that has no effect."""
    out = tmp_path / "ball.ply"
    words = ["fit-triangles", str(ball_capture), "-o", str(out), "--max-steps", "20", "--separate", *SMALL]
    assert main(words) == 0
    mesh = trimesh.load(out, process=False)
    assert len(mesh.vertices) == 3 * len(mesh.faces)
    assert 300 < len(mesh.faces) <= 1500


@pytest.mark.parametrize("percent", [5, 80])
def test_an_interrupted_fit_writes_its_mesh(
    ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, percent: int
) -> None:
    """Catches results that are lost after Ctrl-C, in the soft and in the opaque phase."""
    original = frame._FrameFit.run

    def interrupted(self: frame._FrameFit) -> Iterator[int]:
        for done in original(self):
            if done >= percent:
                raise KeyboardInterrupt
            yield done

    monkeypatch.setattr(frame._FrameFit, "run", interrupted)
    out = tmp_path / "ball.ply"
    assert main(["fit-triangles", str(ball_capture), "-o", str(out), "--max-steps", "20", *SMALL]) == 130
    assert trimesh.load(out, process=False).is_watertight


def test_captures_without_masks_are_refused(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a message that differs from the message of fourd mesh."""
    bare = tmp_path / "bare"
    shutil.copytree(ball_capture, bare, ignore=shutil.ignore_patterns("masks", ".fourd"))
    assert main(["fit-triangles", str(bare), "-o", str(tmp_path / "a.glb")]) == 2
    ours = capsys.readouterr().err
    assert main(["mesh", str(bare), "-o", str(tmp_path / "meshes")]) == 2
    assert ours.removeprefix("fourd fit-triangles: ") == capsys.readouterr().err.removeprefix("fourd mesh: ")
    assert "expected masks/CAM/FRAME.png or mattes, got none" in ours


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--frame", "-1"], "--frame: expected 0 to 2, the frames of the capture, got -1"),
        (["--frame", "3"], "--frame: expected 0 to 2, the frames of the capture, got 3"),
        (["--triangles", "3"], "--triangles: expected at least 16, got 3"),
        (["--cells", "4"], "--cells: expected at least 8, got 4"),
        (["--max-steps", "0"], "--max-steps: expected at least 1, got 0"),
        (["--max-seconds", "0"], "--max-seconds: expected a number of seconds above 0, got 0"),
        (["--agreement", "2"], "--agreement: expected a share in (0, 1], got 2"),
        (["--test-views", "77"], "--test-views: expected"),
        (["-o", "a.obj"], "a.obj: expected a file name that ends in .glb or .ply, got '.obj'"),
    ],
)
def test_bad_options_are_named(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    """Catches a wrong option that ends in a traceback, is reported only after the fit, or is ignored."""
    out = [] if "-o" in words else ["-o", str(tmp_path / "a.glb")]
    assert main(["fit-triangles", str(ball_capture), *out, *words]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
