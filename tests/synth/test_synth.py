"""Tests that the ground truth of synthetic captures is correct, that the settings determine every byte, and that other
folders are not damaged.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.recording.capture import open_capture
from fourd.recording.synth import make_synthetic
from fourd.recording.synth import render as render_module
from fourd.recording.synth.figure import Part, make_figure, pose_figure
from fourd.recording.synth.patterns import Pattern
from fourd.recording.synth.render import render_figure

SMALL = {"frames": 3, "cameras": 4, "size": 72}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small synthetic capture that all tests of this module read."""
    path = tmp_path_factory.mktemp("synth") / "capture"
    make_synthetic(path, **SMALL)
    return path


def _contents(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


def _depth(folder: Path, camera: str, frame: int) -> NDArray[np.float64]:
    depth = cv2.imread(str(folder / "truth" / "depth" / camera / f"{frame:06d}.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    return depth.astype(np.float64) / 1000


def _unproject(camera: Camera, depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """World points (N, 3) of the N pixels that have a depth."""
    i, j = np.nonzero(depth)
    rays = np.stack([j + 0.5, i + 0.5, np.ones(len(i))], axis=1) @ np.linalg.inv(camera.intrinsics).T
    return (rays * depth[i, j, None] - camera.translation) @ camera.rotation


def test_bytes_depend_on_the_seed_alone(folder: Path, tmp_path: Path) -> None:
    """Catches random numbers that do not depend on the seed, and threads that share random state."""
    make_synthetic(tmp_path / "same", **SMALL)
    make_synthetic(tmp_path / "other", **SMALL, seed=1)
    first, same, other = _contents(folder), _contents(tmp_path / "same"), _contents(tmp_path / "other")
    assert first == same
    assert first.keys() == other.keys()
    assert all(first[name] != other[name] for name in first if name.startswith(("images", "masks", "truth/depth")))


def test_capture_opens_with_every_camera_and_frame(folder: Path) -> None:
    """Catches a synthetic capture that the capture reader refuses."""
    capture = open_capture(folder)
    assert capture.names == ("00", "01", "02", "03")
    assert capture.frame_count == SMALL["frames"]
    assert capture.has_masks
    assert capture.image(3, 2).shape == (72, 72, 3)
    assert (folder / "truth" / "bgs" / "03.png").exists()


def test_mask_depth_and_picture_agree(folder: Path) -> None:
    """Catches a mask, a depth map and an image that show different poses."""
    capture = open_capture(folder)
    for camera, name in enumerate(capture.names):
        plate = cv2.imread(str(folder / "truth" / "bgs" / f"{name}.png"))[..., ::-1].astype(int)
        for frame in range(capture.frame_count):
            mask, depth = capture.mask(camera, frame), _depth(folder, name, frame)
            assert (depth[mask == 255] > 0).all()
            assert (depth[mask == 0] == 0).all()
            far = cv2.dilate(mask, np.ones((17, 17), np.uint8)) == 0
            difference = np.abs(capture.image(camera, frame).astype(int) - plate)
            assert difference[far].max() <= 16, "more than JPEG artefacts"
            assert difference[mask == 255].mean() > 30


def test_depth_is_consistent_between_cameras(tmp_path: Path) -> None:
    """Catches depth along the ray instead of along z, half-pixel shifts, and cameras that do not match their images."""
    folder = tmp_path / "capture"
    make_synthetic(folder, frames=1, cameras=16, size=96)
    capture = open_capture(folder)
    for frame in range(capture.frame_count):
        for source, target in ((0, 1), (1, 2), (9, 8)):
            xyz = _unproject(capture.cameras[source], _depth(folder, capture.names[source], frame))
            camera = capture.cameras[target]
            pixels, z = camera.project(xyz)
            depth = _depth(folder, capture.names[target], frame)
            seen = depth[np.floor(pixels[:, 1]).astype(int), np.floor(pixels[:, 0]).astype(int)]
            mask = cv2.dilate(capture.mask(target, frame), np.ones((3, 3), np.uint8))
            inside = mask[np.floor(pixels[:, 1]).astype(int), np.floor(pixels[:, 0]).astype(int)]
            assert (inside > 0).all()
            hidden = z > seen + 0.06
            assert (z[seen > 0] > seen[seen > 0] - 0.1).mean() > 0.98
            visible = (seen > 0) & ~hidden
            assert visible.sum() > 20
            pixel = np.median(z) / camera.intrinsics[0, 0]
            assert np.median(np.abs(z[visible] - seen[visible])) < 0.5 * pixel


def test_figure_fills_the_picture_and_is_never_cropped(folder: Path) -> None:
    """Catches cameras whose images crop a hand or show the figure too small."""
    capture = open_capture(folder)
    for camera in range(len(capture.names)):
        for frame in range(capture.frame_count):
            mask = capture.mask(camera, frame)
            assert max(mask[[0, -1]].max(), mask[:, [0, -1]].max()) == 0
            assert (mask > 0).any(axis=1).mean() > 0.5


def test_figure_moves_and_the_gait_is_a_loop() -> None:
    """Catches a figure that does not move, and a gait that jumps between the last and the first frame."""
    figure = make_figure(5)
    positions = np.stack([[part.origin for part in pose_figure(figure, phase)] for phase in np.arange(25) / 24])
    assert np.linalg.norm(positions[1:] - positions[:-1], axis=-1).max(axis=1).min() > 0.05
    assert np.linalg.norm(np.diff(positions, axis=0), axis=-1).max() < 0.35
    np.testing.assert_allclose(positions[0], positions[-1], atol=1e-9)


def test_figure_stays_above_the_floor() -> None:
    """Catches a figure whose feet are below the floor."""
    for seed in range(4):
        figure = make_figure(seed)
        for phase in np.arange(24) / 24:
            lowest = min(c[2] - radius for part in pose_figure(figure, phase) for c, radius in part.spheres())
            assert -0.01 < lowest < 0.25


def _test_camera(size: int) -> Camera:
    intrinsics = np.array([[1.1 * size, 0, 0.47 * size], [0, 1.1 * size, 0.52 * size], [0, 0, 1]])
    return look_at(
        np.array([2.0, 0.4, 0.9]), np.array([0, 0.1, 0.05]), np.array([0.0, 0.0, 1.0]), intrinsics, size, size
    )


def _random_part(rng: np.random.Generator, length: float) -> Part:
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    frame *= np.sign(np.linalg.det(frame))
    radii = (0.3, 0.3) if length == 0 else (float(rng.uniform(0.1, 0.35)), float(rng.uniform(0.1, 0.35)))
    stretch = rng.uniform(0.6, 1.3, size=3)
    return Part(frame, rng.uniform(-0.15, 0.15, size=3), stretch, length, radii, Pattern("plain", (1, 1, 1), (0, 0, 0)))


def _signed_distance(part: Part, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Approximate signed distance to the unscaled part: the minimum distance to many spheres along the part's axis."""
    local = (xyz - part.origin) @ part.frame / part.stretch
    share = np.linspace(0, 1, 401)[:, None]
    along = local[None, :, 2] - share * part.length
    radius = part.radii[0] * (1 - share) + part.radii[1] * share
    return np.min(np.sqrt((local[:, :2] ** 2).sum(1) + along**2) - radius, axis=0)


@pytest.mark.parametrize("length", [0.0, 0.1, 0.6])
def test_intersections_lie_on_the_rounded_cone(rng: np.random.Generator, length: float) -> None:
    """Catches a wrong root of the ray equation or a missing cap of a rounded cone. The cases include cones in which one
    sphere contains the other sphere.
    """
    camera = _test_camera(48)
    for _ in range(20):
        part = _random_part(rng, length)
        picture = render_figure([part], camera, np.zeros((48, 48, 3)), 0.0)
        xyz = _unproject(camera, picture.depth / 1000.0)
        assert len(xyz) > 8
        assert np.abs(_signed_distance(part, xyz)).max() < 0.003
        towards = xyz + (camera.centre - xyz) * np.linspace(0.01, 0.5, 20)[:, None, None]
        assert _signed_distance(part, towards.reshape(-1, 3)).min() > -0.003


def test_soft_mask_is_the_coverage(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a mask that is thresholded, and ray samples that are not symmetric about the pixel centre."""
    camera, plate = _test_camera(40), np.zeros((40, 40, 3))
    ball = Part(np.eye(3), np.zeros(3), np.ones(3), 0.0, (0.4, 0.4), Pattern("plain", (1, 1, 1), (0, 0, 0)))
    mask = render_figure([ball], camera, plate, 0.0).mask
    monkeypatch.setattr(render_module, "SAMPLES", 15)
    fine_mask = render_figure([ball], camera, plate, 0.0).mask
    assert ((mask > 0) & (mask < 255)).sum() > 40
    assert np.abs(mask.astype(int) - fine_mask).max() < 0.2 * 255
    assert abs(float(mask.mean()) - float(fine_mask.mean())) < 0.3


def test_bands_have_no_seams(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches seams between the bands in which large images are traced."""
    parts, camera = pose_figure(make_figure(0), 0.3), _test_camera(64)
    plate = np.full((64, 64, 3), 0.4)
    whole = render_figure(parts, camera, plate, 0.3)
    monkeypatch.setattr(render_module, "BAND_SAMPLES", 64 * 9 * 5)
    banded = render_figure(parts, camera, plate, 0.3)
    assert all(np.array_equal(getattr(whole, name), getattr(banded, name)) for name in ("rgb", "mask", "depth"))


def test_gloss_brightens_and_depends_on_the_view() -> None:
    """Catches highlights that are missing or do not depend on the viewpoint."""
    ball = Part(np.eye(3), np.zeros(3), np.ones(3), 0.0, (0.4, 0.4), Pattern("plain", (0.3, 0.3, 0.3), (0, 0, 0)))
    plate = np.zeros((48, 48, 3))
    camera = _test_camera(48)
    matte, glossy = (render_figure([ball], camera, plate, gloss).rgb.astype(int) for gloss in (0.0, 0.5))
    assert (glossy >= matte).all()
    assert (glossy - matte).max() > 80
    i, j = np.unravel_index((glossy - matte).sum(axis=2).argmax(), (48, 48))
    depth = render_figure([ball], camera, plate, 0.0).depth / 1000.0
    spot = np.zeros_like(depth)
    spot[i, j] = depth[i, j]
    xyz = _unproject(camera, spot)
    other = look_at(np.array([1.2, 1.7, 0.5]), np.zeros(3), np.array([0.0, 0.0, 1.0]), camera.intrinsics, 48, 48)
    x, y = np.floor(other.project(xyz)[0][0]).astype(int)
    glow = [render_figure([ball], other, plate, gloss).rgb[y, x].astype(int).sum() for gloss in (0.0, 0.5)]
    assert glow[1] - glow[0] < 0.5 * (glossy - matte)[i, j].sum()


def test_finished_captures_are_kept_until_settings_change(tmp_path: Path) -> None:
    """Catches a finished capture that is made again, and old frames of a longer capture that remain among the new
    frames."""
    out = tmp_path / "capture"
    make_synthetic(out, frames=2, cameras=3, size=32)
    before = (out / "images" / "00" / "000000.jpg").stat().st_mtime_ns
    make_synthetic(out, frames=2, cameras=3, size=32)
    assert (out / "images" / "00" / "000000.jpg").stat().st_mtime_ns == before
    make_synthetic(out, frames=1, cameras=3, size=32)
    assert open_capture(out).total_frames == 1


def test_other_folders_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a generator that writes into a folder with the user's files, or removes these files."""
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "mine.txt").write_text("mine")
    assert main(["synth", str(tmp_path), "--frames", "1", "--size", "32"]) == 2
    assert "expected an empty folder or a synthetic capture" in capsys.readouterr().err
    assert (tmp_path / "images" / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("option", "value"), [("frames", "0"), ("cameras", "2"), ("size", "31"), ("gloss", "1.5"), ("gloss", "nan")]
)
def test_numbers_out_of_range_are_refused(
    option: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches values out of range that are reported only after files are written."""
    assert main(["synth", str(tmp_path / "out"), f"--{option}", value]) == 2
    assert f"--{option}: expected" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_file_instead_of_a_folder_is_refused(tmp_path: Path) -> None:
    """Catches a traceback if the output folder OUT is a file."""
    (tmp_path / "out").write_text("")
    with pytest.raises(UserError, match="expected a folder, got a file"):
        make_synthetic(tmp_path / "out")
