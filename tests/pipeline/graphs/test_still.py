"""Captures without mattes in which nothing moves, and captures of a single frame without mattes."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from fourd.base.errors import UserError
from fourd.pipeline.make import make_scene
from fourd.pipeline.stage import Context
from fourd.pipeline.still_scenes import stands_still
from fourd.recording.capture import open_capture
from fourd.recording.matting.sequence import MatteSettings
from fourd.scene.container import SceneReader
from tests.pipeline.graphs.test_plan import planned
from tests.training.small import SMALL, full_config, with_steps


def write_photos(capture: Path, folder: Path) -> Path:
    """Photos of the first frame of a capture, with transforms.json."""
    opened = open_capture(capture, frames="0:1")
    entries = []
    (folder / "images").mkdir(parents=True)
    for index, (name, camera) in enumerate(zip(opened.names, opened.cameras, strict=True)):
        picture = cv2.cvtColor(opened.image(index, 0), cv2.COLOR_RGB2BGR)
        cv2.imwrite(str(folder / "images" / f"{name}.png"), picture)
        pose = np.eye(4)
        pose[:3, :3] = camera.rotation.T @ np.diag([1.0, -1.0, -1.0])
        pose[:3, 3] = camera.centre
        (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
        entries.append(
            {"file_path": f"images/{name}.png", "transform_matrix": pose.tolist()}
            | {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height}
        )
    (folder / "transforms.json").write_text(json.dumps({"frames": entries}))
    return folder


def test_photos_become_a_whole_scene(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a scene without foreground that fails in any stage from photos to the scene file, and clean plates with
    holes."""
    photos, out = write_photos(ball_capture, tmp_path / "photos"), tmp_path / "scene.4dv"
    text = io.StringIO()
    context = Context(Console(file=text, width=300))
    config = with_steps(full_config(tmp_path / "seeds.ply"), 2)
    assert "still, points, plates, background" in planned(photos, config, 1)
    make_scene(photos, out, config, MatteSettings(), context)
    assert "still scene: one frame: the background is made from the images of frame 0" in text.getvalue()
    plate = cv2.imread(str(next((tmp_path / "scene.work" / "run" / "background" / "plates").iterdir())), -1)
    assert plate.shape[2] == 4
    assert (plate[..., 3] == 255).all()
    assert not (photos / "masks").exists()
    assert SceneReader(out).manifest.points == (0,)


def test_one_frame_without_mattes_needs_a_full_scene(ball_capture: Path, tmp_path: Path) -> None:
    """Catches an error about missing motion that does not say how to make a scene of a single frame."""
    photos = write_photos(ball_capture, tmp_path / "photos")
    with pytest.raises(
        UserError, match=r"expected a moving subject or a folder masks/, got only one frame and no masks; add --scene"
    ):
        make_scene(photos, tmp_path / "scene.4dv", with_steps(SMALL, 2), MatteSettings(), Context())


def test_moving_and_still_captures_are_told_apart(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a capture with motion that is treated as still, and noise that counts as motion."""
    config = full_config(tmp_path / "seeds.ply")
    assert not stands_still(ball_capture, config), "the capture has masks"
    moving = Path(shutil.copytree(ball_capture, tmp_path / "moving", ignore=shutil.ignore_patterns("masks")))
    assert not stands_still(moving, config)
    still = Path(shutil.copytree(moving, tmp_path / "still"))
    rng = np.random.default_rng(0)
    for camera in (still / "images").iterdir():
        files = sorted(camera.iterdir())
        first = cv2.imread(str(files[0])).astype(float)
        for file in files:
            cv2.imwrite(str(file), np.clip(first + rng.normal(0, 3, first.shape), 0, 255).astype(np.uint8))
    assert stands_still(still, config)
