"""Detection of poses that are stored as camera-to-world, and of reflections."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera, look_at
from fourd.base.errors import UserError
from fourd.recording.capture import read_calibration, write_calibration
from fourd.recording.capture.focus import describe_inverted
from tests.captures import ring_cameras

K = np.array([[70.0, 0, 32], [0, 70, 32], [0, 0, 1]])
UP = np.array([0.0, 0.0, 1.0])


def moved(cameras: list[Camera], rotation: np.ndarray, shift: np.ndarray) -> list[Camera]:
    """The same rig in a world with another origin and other axes."""
    rotations = [camera.rotation @ rotation.T for camera in cameras]
    return [
        replace(camera, rotation=R, translation=-R @ (rotation @ camera.centre + shift))
        for camera, R in zip(cameras, rotations, strict=True)
    ]


def inverted(cameras: list[Camera]) -> list[Camera]:
    return [replace(camera, rotation=camera.rotation.T, translation=camera.centre) for camera in cameras]


def facing(centres: np.ndarray, directions: np.ndarray) -> list[Camera]:
    return [look_at(c, c + d, UP, K, 64, 64) for c, d in zip(centres, directions, strict=True)]


def test_camera_to_world_poses_of_a_ring_are_named() -> None:
    """Catches a ring of cameras whose poses are stored as camera-to-world and used without a word."""
    found = describe_inverted(inverted(ring_cameras(8, 64)))
    assert found is not None
    assert found.is_sure
    assert "camera-to-world" in found.reason
    three = describe_inverted(inverted(ring_cameras(3, 64)))
    assert three is not None
    assert not three.is_sure


@pytest.mark.parametrize("seed", range(8))
def test_good_rigs_are_not_refused(seed: int) -> None:
    """Catches good rigs that are refused: rings, arcs, cameras side by side, and cameras that look outwards, in worlds
    with any axes and origin."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, 10)
    around = np.stack([np.cos(angle), np.sin(angle), rng.normal(0, 0.2, 10)], axis=1)
    side = np.stack([rng.uniform(-1, 1, 10), np.zeros(10), np.zeros(10)], axis=1)
    forward = np.array([0.0, 1.0, 0.0]) + rng.normal(0, 0.1, (10, 3))
    rotation = Rotation.random(random_state=seed).as_matrix()
    for cameras in (
        facing(3 * around, rng.normal(0, 0.05, (10, 3)) - around),
        facing(side, forward),
        facing(0.3 * around, around),
    ):
        for rig in (cameras, moved(cameras, rotation, rng.normal(0, 3, 3))):
            found = describe_inverted(rig)
            assert found is None or not found.is_sure


def test_calibration_files_with_wrong_poses_are_refused(tmp_path: Path) -> None:
    """Catches a capture reader that uses camera-to-world poses or reflections."""
    names = [f"{index:02d}" for index in range(8)]
    write_calibration(tmp_path, names, inverted(ring_cameras(8, 64)))
    with pytest.raises(UserError, match=r"extri.yml: all cameras stand at nearly one place, .*; invert the poses"):
        read_calibration(tmp_path)
    write_calibration(tmp_path, names, ring_cameras(8, 64))
    text = (tmp_path / "extri.yml").read_text()
    matrix = ring_cameras(8, 64)[3].rotation
    start = text.index("Rot_03")
    data = text.index("data:", start)
    end = text.index("]", data)
    mirrored = ", ".join(f"{value:.17g}" for value in (np.diag([1.0, 1.0, -1.0]) @ matrix).ravel())
    (tmp_path / "extri.yml").write_text(f"{text[:data]}data: [ {mirrored} {text[end:]}")
    with pytest.raises(UserError, match=r"extri.yml: camera '03': rotation: .* got a reflection \(determinant -1\)"):
        read_calibration(tmp_path)
