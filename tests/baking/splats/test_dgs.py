"""Files of the format 4dgs, written and read, and compared with the package fourdgs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.scene import SceneWriter, open_scene
from fourd.scene.exporting.export import ExportSettings, export_scene
from fourd.scene.packing.pack import pack_scene
from fourd.scene.splats.dgs_reader import DgsReader
from fourd.scene.splats.ply import read_splat_ply
from tests.baking.damage import damage
from tests.baking.scenes import full_manifest, manifest, random_frame, room_frame, write_full_scene, write_scene

fourdgs = pytest.importorskip("fourdgs")
FPS = 24.0


def export(scene: Path, out: Path, frames: tuple[int, ...] = (0, 1, 2), **options: Any) -> Path:
    with open_scene(scene) as opened:
        export_scene(opened, out, ExportSettings("4dgs", frames, **options))
    return out


def gaussians(count: int = 50, **values: Any) -> Any:
    """Splats of the package fourdgs. They are shown during the whole scene and do not move."""
    rng = np.random.default_rng(5)
    rotation = rng.normal(size=(count, 4))
    content = {
        "positions": rng.normal(0, 0.3, (count, 3)),
        "scales": rng.uniform(0.01, 0.03, (count, 3)),
        "rotations": rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        "colors": rng.uniform(0, 1, (count, 4)),
        "motions": np.zeros((count, 3)),
        "mu_t": np.zeros(count),
        "sigma_t": np.full(count, np.inf),
        "win_lo": np.zeros(count),
        "win_hi": np.full(count, 2.0),
    }
    return fourdgs.GaussianSet(**{name: np.asarray(each, np.float32) for name, each in (content | values).items()})


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_the_package_finds_no_error_in_written_files(tmp_path: Path, degree: int) -> None:
    """Catches records that break the specification, and a header that was not written again at the end."""
    from fourdgs.validate import validate

    write_scene(tmp_path / "a.4dv")
    path = export(tmp_path / "a.4dv", tmp_path / "a.4dgs", degree=degree)
    assert validate(path.read_bytes()).ok
    read = fourdgs.read(str(path))
    assert (read.header.gaussian_count, read.header.sh_degree, read.duration_sec) == (603, degree, 3 / FPS)
    assert len(read.chunk_index) == 3
    assert read.summary_crc_ok


def test_the_package_reads_the_splats_of_every_frame(tmp_path: Path) -> None:
    """Catches splats in the wrong frame, quaternions in the order of PLY files, and colours or axes that differ from
    those of a PLY sequence."""
    write_scene(tmp_path / "a.4dv")
    path = export(tmp_path / "a.4dv", tmp_path / "a.4dgs", keep_axes=True)
    with open_scene(tmp_path / "a.4dv") as scene:
        export_scene(scene, tmp_path / "ply", ExportSettings("ply-sequence", (0, 1, 2), keep_axes=True))
    read = fourdgs.read(str(path))
    for index, file in enumerate(sorted((tmp_path / "ply").iterdir())):
        cloud = read_splat_ply(file)
        for time in (index / FPS, (index + 0.5) / FPS, (index + 0.999) / FPS):
            state = read.state_at(time)
            assert len(state["indices"]) == len(cloud)
        step = 0.05 * float(np.median(cloud.scale))
        assert np.abs(np.sort(state["centers"], axis=0) - np.sort(cloud.xyz, axis=0)).max() < step
        colours = read.gaussians.colors[state["indices"], :3]
        assert np.abs(np.sort(colours, axis=0) - np.sort(cloud.base_colour, axis=0)).max() < 0.01


def test_a_file_comes_back_as_the_same_scene(tmp_path: Path) -> None:
    """Catches a wrong frame rate, a wrong up direction, and spherical harmonics of the wrong colour or degree."""
    with SceneWriter(tmp_path / "a.4dv", replace(manifest(), metres_per_unit=0.5)) as writer:
        for index in range(3):
            writer.add_frame(index, random_frame(200, 6, seed=index))
    path = export(tmp_path / "a.4dv", tmp_path / "a.4dgs", keep_axes=True)
    turned = export(tmp_path / "a.4dv", tmp_path / "b.4dgs")
    with open_scene(tmp_path / "a.4dv") as scene:
        export_scene(scene, tmp_path / "ply", ExportSettings("ply-sequence", (1,), keep_axes=True))
        camera = scene.manifest.cameras[0]
    with open_scene(path) as read, open_scene(tmp_path / "ply") as splats:
        assert (read.manifest.fps, read.manifest.is_fps_known, len(read)) == (FPS, True, 3)
        wanted, found = splats.render(camera, 0), read.render(camera, 1)
        assert np.sqrt(np.square(found.rgb - wanted.rgb).mean()) < 0.02
        assert np.abs(found.alpha - wanted.alpha).mean() < 0.01
    with open_scene(turned) as read:
        assert read.manifest.metres_per_unit == 0.5


def test_every_second_frame_plays_at_the_speed_of_the_recording(tmp_path: Path) -> None:
    """Catches an export of every second frame that plays twice as fast."""
    write_scene(tmp_path / "a.4dv")
    reader = DgsReader(export(tmp_path / "a.4dv", tmp_path / "a.4dgs", (0, 2)))
    assert (reader.rate, reader.manifest.frame_count) == (FPS / 2, 2)
    assert [len(reader.cloud(index)) for index in range(2)] == [200, 202]
    reader.close()


def test_the_background_is_stored_once(tmp_path: Path) -> None:
    """Catches files that contain the static points in every frame, and frames without static points."""
    write_full_scene(tmp_path / "a.4dv")
    path = export(tmp_path / "a.4dv", tmp_path / "a.4dgs")
    assert fourdgs.read(str(path)).header.gaussian_count == 200 + 201 + 202 + 300
    reader = DgsReader(path)
    assert [len(reader.cloud(index)) for index in range(3)] == [500, 501, 502]
    reader.close()


def test_frames_without_points(tmp_path: Path) -> None:
    """Catches a division by zero in the writer for an empty first frame, and a reader that shows another frame."""
    with SceneWriter(tmp_path / "a.4dv", full_manifest()) as writer:
        writer.add_background(room_frame(30, 6, seed=1))
        for index, count in enumerate((0, 40, 0)):
            writer.add_frame(index, random_frame(count, 6, seed=index))
    reader = DgsReader(export(tmp_path / "a.4dv", tmp_path / "a.4dgs"))
    assert [len(reader.cloud(index)) for index in range(3)] == [30, 70, 30]
    reader.close()


def test_splats_of_other_programs_move_and_fade(tmp_path: Path) -> None:
    """Catches velocities and fades that are ignored."""
    velocity = np.tile([[1.0, 0, 0]], (50, 1))
    moving = gaussians(motions=velocity, mu_t=np.ones(50))
    fading = gaussians(mu_t=np.full(50, 1.0), sigma_t=np.full(50, 0.4))
    fourdgs.write(str(tmp_path / "moving.4dgs"), moving, 2.0)
    fourdgs.write(str(tmp_path / "fading.4dgs"), fading, 2.0)
    reader = DgsReader(tmp_path / "moving.4dgs")
    assert (reader.manifest.frame_count, reader.rate, reader.is_rate_known) == (60, 30.0, False)
    shift = np.median(reader.cloud(59).xyz[:, 0]) - np.median(reader.cloud(0).xyz[:, 0])
    assert shift == pytest.approx(59 / 30, abs=0.01)
    reader.close()
    reader = DgsReader(tmp_path / "fading.4dgs")
    brightest, edge = reader.cloud(30), reader.cloud(12)
    share = np.exp(-0.5 * (17.5 / 30 / 0.4) ** 2)
    assert edge.opacity.mean() == pytest.approx(brightest.opacity.mean() * share, rel=0.1)
    reader.close()


def test_the_rate_of_a_converted_ply_sequence(tmp_path: Path) -> None:
    """Catches frames that are skipped or shown twice, because the file of another program does not state a rate."""
    from fourdgs.convert import convert_ply_sequence

    write_scene(tmp_path / "a.4dv")
    with open_scene(tmp_path / "a.4dv") as scene:
        export_scene(scene, tmp_path / "ply", ExportSettings("ply-sequence", (0, 1, 2)))
    converted, seconds = convert_ply_sequence(str(tmp_path / "ply"), fps=12.0)
    fourdgs.write(str(tmp_path / "a.4dgs"), converted, seconds)
    reader = DgsReader(tmp_path / "a.4dgs")
    assert reader.rate == pytest.approx(12.0, rel=1e-5)
    assert [len(reader.cloud(index)) for index in range(3)] == [200, 201, 202]
    reader.close()


@pytest.mark.parametrize("tier", ["full", "stream", "light"])
def test_packed_splats_keep_their_colours(tmp_path: Path, tier: Any) -> None:
    """Catches the spherical harmonics of splats, whose range is large, that are stored with the steps for the small
    range of trained scenes: the colours of a packed scene were then wrong by a tenth."""
    fourdgs.write(str(tmp_path / "a.4dgs"), gaussians(400, colors=np.full((400, 4), [0.7, 0.3, 0.2, 0.95])), 0.1)
    pack_scene(tmp_path / "a.4dgs", tmp_path / "a.4dv", tier, untracked)
    with open_scene(tmp_path / "a.4dgs") as splats, open_scene(tmp_path / "a.4dv") as packed:
        camera = splats.manifest.cameras[0]
        wanted, found = splats.render(camera, 0), packed.render(camera, 0)
    seen = (wanted.alpha > 0.9) & (found.alpha > 0.9)
    assert seen.sum() > 100
    assert np.abs(found.rgb[seen] - wanted.rgb[seen]).mean() < 0.02


def test_broken_files(tmp_path: Path) -> None:
    """Catches tracebacks, files without an index that show nothing, and endless durations."""
    options = fourdgs.WriteOptions(write_index=False)
    fourdgs.write(str(tmp_path / "index.4dgs"), gaussians(), 2.0, options=options)
    fourdgs.write(str(tmp_path / "long.4dgs"), gaussians(), 1e9)
    fourdgs.write(str(tmp_path / "empty.4dgs"), gaussians(0), 2.0)
    (tmp_path / "text.4dgs").write_text("text")
    expected = {
        "index": "no index of its chunks",
        "long": "a duration of 1e\\+09 s",
        "empty": "expected at least one splat with finite values, got none",
        "text": "expected a valid file of the format 4dgs, got: ",
        "absent": "expected a readable file, got 'No such file or directory'",
    }
    for name, message in expected.items():
        with pytest.raises(UserError, match=message):
            open_scene(tmp_path / f"{name}.4dgs")


def test_damaged_files_never_escape(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches exceptions other than UserError in the reader."""
    path = tmp_path / "a.4dgs"
    fourdgs.write(str(path), gaussians(motions=np.ones((50, 3))), 0.2)
    content = path.read_bytes()
    for _ in range(150):
        path.write_bytes(damage(content, rng, 20))
        try:
            with open_scene(path) as scene:
                for index in range(min(len(scene), 2)):
                    scene.frame(index)
        except UserError as error:
            assert "\n" not in str(error)  # noqa: PT017
            assert "a.4dgs" in str(error)  # noqa: PT017


def test_the_name_of_the_file(tmp_path: Path) -> None:
    """Catches a folder for a format that has one file for all frames."""
    write_scene(tmp_path / "a.4dv")
    with pytest.raises(UserError, match=r"expected a file \.4dgs for --to 4dgs"):
        export(tmp_path / "a.4dv", tmp_path / "folder")
