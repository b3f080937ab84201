"""A recording of a real rig with four web cameras and an inverted, double-sided board. One camera sees the back of the
board.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from fourd.cli.main import main
from fourd.recording.capture.calibration import Calibration, read_calibration

RIG = Path(__file__).parents[2].parent / "shared" / "captures" / "charuco_rig"
LENSES = RIG / "truth" / "camera_array.toml"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not RIG.is_dir(), reason=f"no real capture at {RIG}"),
]


def compare_pairs(found: dict[str, Calibration]) -> tuple[float, float]:
    """Compare the relative poses of camera pairs with Caliscope's. Returns the largest angle in degrees, and the
    largest distance as a fraction of the limit.

    The limit is 2.5% of the baseline, and at least 18 mm.
    """
    truth = tomllib.loads(LENSES.read_text())["cameras"]
    first = [(each.rotation, each.translation) for each in found.values()]
    second = [(np.array(truth[str(k)]["rotation"]), np.array(truth[str(k)]["translation"])) for k in range(4)]
    angles, shares = [], []
    for i in range(4):
        for j in range(i):
            poses = []
            for some in (first, second):
                rotation = some[i][0] @ some[j][0].T
                poses.append((rotation, some[i][1] - rotation @ some[j][1]))
            (rotation, position), (true_rotation, true_position) = poses
            cosine = (np.trace(rotation @ true_rotation.T) - 1) / 2
            angles.append(float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))))
            limit = max(0.018, 0.025 * float(np.linalg.norm(true_position)))
            shares.append(float(np.linalg.norm(position - true_position)) / limit)
    return max(angles), max(shares)


def test_poses_with_known_lenses(tmp_path: Path) -> None:
    """Catches wrong corners on the back of the board, and camera poses that disagree with the poses of another
    program."""
    out = tmp_path / "calibration"
    words = ["calibrate", RIG, "--board", RIG / "board.toml", "-o", out, "--intrinsics", LENSES]
    assert main([str(word) for word in words]) == 0
    degrees, share = compare_pairs(read_calibration(out))
    # Caliscope assumes that all rows of all cameras are exposed at the same time. This is not the case for these web
    # cameras.
    assert degrees < 1.0
    assert share < 0.4
    report = json.loads((out / "report.json").read_text())
    assert max(camera["fit_px"] for camera in report["cameras"].values()) < 0.7
    assert max(camera["held_out_px"] for camera in report["cameras"].values()) < 0.8


def test_lenses_from_the_board(tmp_path: Path) -> None:
    """Catches lenses that are changed to compensate for different exposure times of the cameras. Also catches a report
    that does not warn about uncertain orientations."""
    out = tmp_path / "calibration"
    assert main([str(word) for word in ["calibrate", RIG, "--board", RIG / "board.toml", "-o", out]]) == 0
    truth = tomllib.loads(LENSES.read_text())["cameras"]
    found = read_calibration(out)
    for name, camera in found.items():
        true = np.array(truth[name.removeprefix("cam_")]["matrix"])
        assert np.abs(np.diag(camera.intrinsics)[:2] / np.diag(true)[:2] - 1).max() < 0.01
    degrees, share = compare_pairs(found)
    assert degrees < 1.2
    assert share < 0.6
    report = json.loads((out / "report.json").read_text())
    assert any("orientation is uncertain" in line for c in report["cameras"].values() for line in c["warnings"])
    for camera in report["timing"].values():
        assert 20 < abs(camera["readout_ms"]) < 45
        assert abs(camera["delay_ms"]) < 30
    assert 0.002 < report["board_thickness_m"] < 0.005
