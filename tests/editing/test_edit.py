"""``fourd edit``, from the command line."""

from __future__ import annotations

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.cli.main import main
from fourd.scene import SceneReader, SceneWriter, open_scene
from fourd.scene.scene import BakedFrame
from tests.baking.scenes import manifest, random_frame, write_full_scene, write_scene


def edit(source: Path, out: Path, *words: object) -> int:
    return main(["edit", str(source), "-o", str(out), *(str(word) for word in words)])


def psnr(one: np.ndarray, two: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(one - two).mean() + 1e-12))


def at(frame: BakedFrame, place: tuple[float, float, float], colour: int) -> BakedFrame:
    """Return a small opaque ball of one colour."""
    return replace(
        frame,
        xyz=(0.3 * frame.xyz + np.float32(place)).astype(np.float32),
        density=np.ones_like(frame.density),
        sh=np.zeros_like(frame.sh),
        rgb=np.full_like(frame.rgb, colour),
    )


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write_scene(tmp_path / "scene.4dv", frames=6)
    return tmp_path / "scene.4dv"


def test_frames_of_a_packed_scene_are_copied(scene: Path, tmp_path: Path) -> None:
    """Catches a cut that quantises points again, or that keeps other frames than the named ones."""
    packed, out = tmp_path / "packed.4dv", tmp_path / "out.4dv"
    assert main(["pack", str(scene), "-o", str(packed), "--tier", "stream"]) == 0
    assert edit(packed, out, "--trim", "1:6:2", "--speed", 2) == 0
    before, after = SceneReader(packed), SceneReader(out)
    assert after.manifest.frame_numbers == (11, 13, 15)
    assert after.manifest.fps == 2 * before.manifest.fps
    for index, frame in enumerate((1, 3, 5)):
        one, two = before.read(frame).arrays, after.read(index).arrays
        assert all((one[name] == two[name]).all() for name in one)
    before.close()
    after.close()


@pytest.mark.parametrize("tier", [None, "full"])
def test_points_outside_a_region_are_left_out(scene: Path, tmp_path: Path, tier: str | None) -> None:
    """Catches a crop that changes the other points, and a scene that is packed although its source is not."""
    source, out = scene, tmp_path / "out.4dv"
    if tier is not None:
        source = tmp_path / "packed.4dv"
        assert main(["pack", str(scene), "-o", str(source), "--tier", tier]) == 0
    assert edit(source, out, "--crop", "box=0,-9,-9,9,9,9", "--crop", "cylinder=0.5,0,0,0") == 0
    before, after = SceneReader(source), SceneReader(out)
    encoding = after.manifest.encoding
    assert (encoding.tier if encoding else None) == tier
    xyz = after.read(2).xyz
    expected = before.read(2).xyz
    inside = (expected[:, 0] >= 0) & (np.hypot(expected[:, 0], expected[:, 1]) <= 0.5)
    # Points that a tier does not show are left out when the scene is packed.
    assert len(xyz) == inside.sum() if tier is None else len(xyz) <= inside.sum()
    assert len(xyz) > 0.8 * inside.sum()
    assert xyz[:, 0].min() >= -0.01
    assert after.manifest.bounds[1][0] == pytest.approx(max(after.read(i).xyz[:, 0].max() for i in range(6)), abs=0.02)
    before.close()
    after.close()


def test_a_full_scene_keeps_its_shadows_or_loses_its_background(tmp_path: Path) -> None:
    """Catches shadows that stay as long as the background that was cropped, and a subject with a background's kind."""
    source, out = tmp_path / "full.4dv", tmp_path / "out.4dv"
    _, room, shadows = write_full_scene(source)
    assert edit(source, out, "--crop", "box=0,-99,-99,99,99,99") == 0
    reader = SceneReader(out)
    kept = room.xyz[:, 0] >= 0
    shadow = reader.read_shadow(1)
    assert shadow is not None
    assert (shadow == shadows[1][kept]).all()
    reader.close()
    assert edit(source, out, "--background", "none") == 0
    reader = SceneReader(out)
    assert (reader.manifest.kind, reader.manifest.background) == ("object", None)
    reader.close()


def test_a_scene_is_turned_upright_and_put_on_the_floor(scene: Path, tmp_path: Path) -> None:
    """Catches a floor that is measured before the scene is turned, and pictures that change with the axes."""
    out = tmp_path / "out.4dv"
    assert edit(scene, out, "--up", "-y", "--floor-to-zero", "--scale", 2, "--turn", 30, "--move", 1, 0, 0) == 0
    with open_scene(scene) as before, open_scene(out) as after:
        heights = -np.concatenate([after.frame(frame).xyz[:, 1] for frame in range(6)])
        assert abs(np.percentile(heights, 0.5)) < 0.15
        assert heights.max() > 1
        for camera, other in zip(before.manifest.cameras, after.manifest.cameras, strict=True):
            assert psnr(before.render(camera, 1).rgb, after.render(other, 1).rgb) > 40


def test_two_scenes_hide_each_other(tmp_path: Path) -> None:
    """Catches a second scene that is always drawn on top, and one that ends before the first."""
    one, two, out = tmp_path / "one.4dv", tmp_path / "two.4dv", tmp_path / "out.4dv"
    near = at(random_frame(800, 6, seed=0), (1.0, 0, 0), 255)  # before the ball, as camera 0 at x = 3 sees it
    far = at(random_frame(800, 6, seed=1), (0.0, 0, 0), 60)
    for path, frames, frame in ((one, 5, far), (two, 2, near)):
        with SceneWriter(path, manifest(6, frames)) as writer:
            for index in range(frames):
                writer.add_frame(index, frame)
    assert edit(one, out, "--merge", two) == 0
    with open_scene(out) as scene:
        assert scene.manifest.frame_count == 5
        camera = scene.manifest.camera("00")
        middle = scene.render(camera, 4).rgb[20:28, 20:28].mean()
        behind = scene.render(scene.manifest.camera("03"), 4).rgb[20:28, 20:28].mean()
    assert middle > 0.7
    assert behind < 0.4
    assert edit(one, out, "--merge", two, "--at", -2, 0, 0) == 0
    with open_scene(out) as scene:
        assert scene.render(scene.manifest.camera("00"), 4).rgb[20:28, 20:28].mean() < 0.4


def test_a_subject_before_another_background(scene: Path, tmp_path: Path) -> None:
    """Catches a scene without the other background, and a background of a scene that has none."""
    full, out = tmp_path / "full.4dv", tmp_path / "out.4dv"
    write_full_scene(full)
    assert edit(scene, out, "--background", full) == 0
    with open_scene(out) as after:
        assert after.manifest.kind == "full"
        assert after.render(after.manifest.cameras[0], 0).alpha.mean() > 0.9


def test_an_edit_keeps_its_sources(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a source that is overwritten, and a temporary folder that stays."""
    before = scene.read_bytes()
    assert edit(scene, scene, "--brightness", 0.5) == 2
    assert "scene.4dv" in capsys.readouterr().err
    shutil.copy(scene, tmp_path / "other.4dv")
    assert edit(scene, tmp_path / "other.4dv", "--merge", tmp_path / "other.4dv") == 2
    assert scene.read_bytes() == (tmp_path / "other.4dv").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.4dv", "scene.4dv"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "expected at least one edit, such as --trim 0:24, got none"),
        (("--trim", "4:99"), "--trim: expected A:B with 0 <= A < B <= 6"),
        (("--crop", "ball=3"), "--crop: expected box=X0,Y0,Z0,X1,Y1,Z1"),
        (("--crop", "box=0,0,0,nan,1,1"), "--crop: expected box="),
        (("--crop", "box=5,5,5,6,6,6"), "expected an edit that keeps points, got one that keeps none"),
        (("--scale", "0"), "--scale: expected a factor from"),
        (("--colour", "1", "-1", "1"), "--colour: expected a factor from"),
        (("--metres",), "--metres: expected a scene that states its world unit"),
        (("--at", "1", "0", "0"), "--at, --at-turn: expected also --merge"),
        (("--floater-share", "0.5"), "--floater-share: expected also --remove-floaters"),
        (("--merge", "missing.4dv"), "missing.4dv"),
        (("--background", "SELF"), "--background: expected a scene with a background, got one of a subject alone"),
    ],
)
def test_impossible_edits_are_refused(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    """Catches an option that is ignored, and an edit that leaves a file without points."""
    out = tmp_path / "out.4dv"
    assert edit(scene, out, *(scene if word == "SELF" else word for word in words)) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("fourd edit: ")
    assert message in line
    assert not out.exists()


def test_a_damaged_scene_is_refused(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback on a truncated file, and an output that is left behind."""
    damaged = tmp_path / "damaged.4dv"
    damaged.write_bytes(scene.read_bytes()[:4000])
    assert edit(damaged, tmp_path / "out.4dv", "--trim", "0:1") == 2
    assert "damaged.4dv" in capsys.readouterr().err
    assert not (tmp_path / "out.4dv").exists()
    assert zipfile.is_zipfile(scene)
