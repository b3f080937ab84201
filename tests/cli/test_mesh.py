"""The command fourd mesh on a small synthetic capture: results, resuming, scores and bad input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fourd.base.formats.glb_mesh import read_glb_mesh
from fourd.cli.main import main

SMALL = ["--cells", "24", "--steps", "12", "--texture-size", "128"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mesh") / "capture"
    assert main(["synth", str(folder), "--frames", "3", "--cameras", "9", "--size", "96"]) == 0
    return folder


@pytest.fixture(scope="module")
def made(capture: Path) -> Path:
    out = capture.parent / "meshes"
    words = ["mesh", str(capture), "-o", str(out), "--frames", "0:2", "--test-views", "02,05", *SMALL]
    assert main(words) == 0
    return out


def test_each_frame_has_a_closed_textured_mesh(made: Path) -> None:
    """Catches missing files, empty textures, and meshes that other programs cannot open."""
    assert sorted(path.name for path in made.iterdir()) == [
        "000000.glb", "000001.glb", "animation.glb", "meshes.json", "scores.json",
    ]  # fmt: skip
    for name in ("000000.glb", "000001.glb"):
        mesh = read_glb_mesh(made / name)
        assert mesh.texture.shape == (128, 128, 3)
        assert mesh.texture.std() > 5
        joined = trimesh.Trimesh(mesh.xyz, mesh.triangles, process=True, merge_norm=True, merge_tex=True)
        assert joined.is_watertight
        assert joined.volume > 0
    assert len(trimesh.load(made / "animation.glb").geometry) == 2


def test_held_out_views_are_scored(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches scores that are computed from training views, and meshes that do not match the images."""
    scores = json.loads((made / "scores.json").read_text())
    assert {picture["camera"] for picture in scores["pictures"]} == {"02", "05"}
    assert {picture["frame"] for picture in scores["pictures"]} == {0, 1}
    assert scores["mean"]["iou"] > 0.9
    assert scores["mean"]["psnr"] > 18


def test_finished_frames_are_kept_and_new_settings_replace_them(
    capture: Path, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a resumed command that makes finished frames again, or that keeps frames of other settings."""
    out = tmp_path / "meshes"
    shutil.copytree(made, out)
    (out / "000001.glb").unlink()
    (out / "animation.glb").unlink()
    before = (out / "000000.glb").stat().st_mtime_ns
    words = ["mesh", str(capture), "-o", str(out), "--frames", "0:2", "--test-views", "02,05"]
    assert main([*words, *SMALL]) == 0
    assert (out / "000000.glb").stat().st_mtime_ns == before
    assert (out / "animation.glb").read_bytes() == (made / "animation.glb").read_bytes()
    capsys.readouterr()
    assert main([*words, *SMALL, "--steps", "0"]) == 2
    error = capsys.readouterr().err
    assert "expected meshes of these files and settings, got 3 files that were made with others (fit.steps: " in error
    assert (out / "000000.glb").stat().st_mtime_ns == before
    assert main([*words, *SMALL, "--steps", "0", "--force"]) == 0
    assert (out / "000000.glb").stat().st_mtime_ns != before


def test_other_meshes_are_not_replaced(capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches meshes or points of the user that fourd mesh or fourd carve deletes, because of their names."""
    for command in ("mesh", "carve"):
        (tmp_path / command).mkdir()
        mine = tmp_path / command / "000000.ply"
        mine.write_text("mine")
        assert main([command, str(capture), "-o", str(mine.parent)]) == 2
        assert "expected a new folder or" in (error := capsys.readouterr().err)
        assert "got other files such as 000000.ply; name another folder" in error
        assert mine.read_text() == "mine"


def test_remeshing_gives_fewer_triangles(
    capture: Path, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches remeshing with a length in the wrong unit, and a missing package that is reported only after the fit."""
    words = ["mesh", str(capture), "-o", str(tmp_path), "--frames", "0:1", *SMALL, "--remesh", "1"]
    with monkeypatch.context() as patched:
        patched.setattr("fourd.reconstruction.meshes.surface.remeshing.remeshing_is_available", lambda: False)
        assert main(words) == 2
    assert "--remesh: expected the package gpytoolbox, got none" in capsys.readouterr().err
    pytest.importorskip("gpytoolbox")
    assert main(words) == 0
    before, after = (len(read_glb_mesh(folder / "000000.glb").triangles) for folder in (made, tmp_path))
    assert 0.1 * before < after < 0.6 * before


def test_ply_files_are_in_world_coordinates(capture: Path, made: Path, tmp_path: Path) -> None:
    """Catches PLY meshes in the axes of glTF, and PLY files without colours."""
    words = ["mesh", str(capture), "-o", str(tmp_path), "--frames", "0:1", "--format", "ply", *SMALL]
    assert main([*words, "--test-views", "02,05"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000000.ply", "meshes.json"]
    mesh = trimesh.load(tmp_path / "000000.ply", process=False)
    assert mesh.is_watertight
    other = read_glb_mesh(made / "000000.glb").xyz
    np.testing.assert_allclose(mesh.bounds, [other.min(axis=0), other.max(axis=0)], atol=0.02)
    assert mesh.visual.vertex_colors[:, :3].std() > 5


def test_runs_give_their_views_and_frames(capture: Path, tmp_path: Path) -> None:
    """Catches meshes of a run that are fitted to the run's held-out views."""
    run, overlay = tmp_path / "run", tmp_path / "small.yaml"
    overlay.write_text("points: 1000\nmodel: {hidden: 16, planes: {levels: 2, features: 4, base_resolution: 16}}\n")
    words = ["train", str(capture), "--out", str(run), "--config", str(overlay), "--frames", "1:2"]
    assert main([*words, "--test-views", "02", "--max-steps", "2"]) == 0
    assert main(["mesh", str(run), "-o", str(tmp_path / "meshes"), *SMALL]) == 0
    scores = json.loads((tmp_path / "meshes" / "scores.json").read_text())
    assert {(picture["camera"], picture["frame"]) for picture in scores["pictures"]} == {("02", 1)}
    assert (tmp_path / "meshes" / "000001.glb").exists()


def test_captures_without_masks_are_refused(capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a message that differs from the message of fourd carve, and files that are written before the check."""
    bare = tmp_path / "bare"
    shutil.copytree(capture, bare, ignore=shutil.ignore_patterns("masks", ".fourd"))
    assert main(["mesh", str(bare), "-o", str(tmp_path / "meshes")]) == 2
    ours = capsys.readouterr().err
    assert main(["carve", str(bare)]) == 2
    assert ours.removeprefix("fourd mesh: ") == capsys.readouterr().err.removeprefix("fourd carve: ")
    assert "expected masks/CAM/FRAME.png or mattes, got none" in ours
    assert not (tmp_path / "meshes").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--cells", "4"], "--cells: expected at least 8, got 4"),
        (["--steps", "-1"], "--steps: expected at least 0, got -1"),
        (["--texture-size", "8"], "--texture-size: expected at least 16, got 8"),
        (["--texture-size", "32768"], "--texture-size: expected at most 16384 texels, got 32768"),
        (["--remesh", "-1"], "--remesh: expected 0 or more cells, got -1"),
        (["--agreement", "1.5"], "--agreement: expected a share in (0, 1], got 1.5"),
        (["--format", "obj"], "--format: expected"),
        (["--test-views", "77"], "--test-views: expected"),
        (["--frames", "9:12"], "--frames: expected"),
    ],
)
def test_bad_options_are_named(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    """Catches a wrong option that ends in a traceback or is ignored."""
    assert main(["mesh", str(capture), "-o", str(tmp_path / "meshes"), *words]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert not (tmp_path / "meshes").exists()


def test_empty_frames_are_named(capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback for frames in which the subject has left the scene."""
    import cv2

    copied = tmp_path / "capture"
    shutil.copytree(capture, copied)
    for path in copied.glob("masks/*/000001.png"):
        assert cv2.imwrite(str(path), np.zeros((96, 96), np.uint8))
    assert main(["mesh", str(copied), "-o", str(tmp_path / "meshes"), *SMALL]) == 2
    assert "frame 1: expected an object in the masks, got none in any view" in capsys.readouterr().err
    assert (tmp_path / "meshes" / "000000.glb").exists()
