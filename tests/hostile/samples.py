"""Undamaged files of every kind that fourd reads, with the commands that read these files."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from fourd.base.configs import to_yaml
from fourd.scene.exporting.export import ExportSettings, export_scene
from fourd.scene.packing.pack import pack_scene
from fourd.scene.rendering import open_scene
from fourd.viewer.camera_paths.keys import KeyedPath, KeyFrame
from fourd.viewer.navigation.pose import Pose
from fourd.viewer.navigation.recorded_path import PathSample, RecordedPath
from tests.baking.scenes import write_full_scene, write_scene
from tests.capture.numbered_videos import write_numbered_video
from tests.captures import write_ball_capture
from tests.importing.formats import test_colmap, test_dna_rendering, test_neural3dv
from tests.importing.formats.sources import picture_bytes, uneven_cameras, write_pictures, write_video
from tests.importing.formats.test_anipose import calibration_toml
from tests.importing.formats.test_qualisys import camera_xml
from tests.importing.test_layouts import caliscope_toml
from tests.training.small import SMALL
from tests.viewer.camera_paths.exports import camera_to_world, cameras, viewer_export, write

CALISCOPE = "camera_array.toml"
OUT = "OUT"
"""Placeholder for the path of the output in a command."""
SMALL_IMAGES = "--size 32 24"
RENDER = ("--path", "orbit", "--steps", "1", "--size", "32", "24", "-o", OUT)


@dataclass(frozen=True)
class Sample:
    """A kind of file.

    Attributes:
        name: short description, unique.
        folder: folder with the file and with all other files that the commands need.
        file: the file that is damaged, relative to the folder.
        commands: commands that read the file. FILE and DIR stand for the paths of the file and of the folder.
    """

    name: str
    folder: Path
    file: str
    commands: tuple[tuple[str, ...], ...]


class Samples:
    """Writes the files into a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.all: list[Sample] = []
        for add in (self._scenes, self._captures, self._videos, self._runs, self._settings, self._sources):
            add()

    def _add(self, name: str, file: str, *commands: str) -> Path:
        """Add a sample. Returns its folder."""
        folder = self._folder / name.replace(" ", "-").replace("/", "-")
        words = tuple(tuple(command.split()) for command in commands)
        self.all.append(Sample(name, folder, file, words))
        folder.mkdir(parents=True, exist_ok=True)
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        return folder

    def _scenes(self) -> None:
        render = f"render FILE {' '.join(RENDER)}"
        commands = ("info FILE", "verify FILE", render, "pack FILE -o OUT.4dv", "export FILE --to ply -o OUT")
        folder = self._add("object scene", "a.4dv", *commands)
        write_scene(folder / "a.4dv", views=3, frames=2, points=40)
        write_full_scene(self._add("full scene", "a.4dv", *commands) / "a.4dv", views=3, frames=2, points=40)
        for tier in ("stream", "light"):
            pack_scene(folder / "a.4dv", self._add(f"{tier} scene", "a.4dv", *commands) / "a.4dv", tier)
        for kind, suffix in (("ply", ".ply"), ("ply-sequence", ".ply"), ("splat", ".splat")):
            target = self._add(f"points {kind}", f"a{suffix}", "info FILE", render)
            with open_scene(folder / "a.4dv") as scene:
                export_scene(scene, target / f"a{suffix}", ExportSettings(kind, [0]))  # type: ignore[arg-type]
        path = self._add("camera path", "a.json", "view DIR/a.4dv --renderer cpu --headless OUT.mp4 --path FILE")
        pose = Pose(np.zeros(3), np.eye(3), 3.0, 0.7, np.array([0.0, 0.0, 1.0]), (0.0, 0.0))
        RecordedPath((PathSample(pose, 0), PathSample(pose, 1))).save(path / "a.json")
        nerfstudio = self._add("nerfstudio's path", "a.json", f"render DIR/a.4dv --path FILE -o OUT {SMALL_IMAGES}")
        matrices = [camera_to_world(camera) for camera in cameras(2)]
        write(nerfstudio / "a.json", viewer_export(matrices, [0.0, 1.0]))
        keys = self._add("key frames", "a.json", f"render DIR/a.4dv --path FILE -o OUT {SMALL_IMAGES}")
        KeyedPath((KeyFrame(pose, 0.0, 0.0), KeyFrame(pose, 0.1, 1.0)), 10.0).save(keys / "a.json")
        style = self._add("style", "a.yaml", f"render DIR/a.4dv --style FILE {' '.join(RENDER)}")
        (style / "a.yaml").write_text("shading: toon\nlight: {direction: [0, 1, 1]}\nlines: {thickness: 2}\n")
        for target in (path, style, nerfstudio, keys):
            shutil.copy(folder / "a.4dv", target / "a.4dv")

    def _captures(self) -> None:
        capture = write_ball_capture(self._folder / "ball", cameras=3, frames=1, size=32)
        (capture / "capture.json").write_text('{"version": 1, "fps": "30000/1001"}')
        check = "check DIR --quick --deep"
        for name in ("intri.yml", "extri.yml", "capture.json", "images/00/000000.png", "masks/01/000000.png"):
            commands = (check, "info DIR", "carve DIR -o OUT --points 50 --workers 1")
            shutil.copytree(capture, self._add(f"capture {name}", name, *commands), dirs_exist_ok=True)
        jpeg = self._add("capture of JPEG", "images/00/000000.jpg", check)
        shutil.copytree(capture, jpeg, dirs_exist_ok=True)
        (jpeg / "images/00/000000.png").unlink()
        (jpeg / "images/00/000000.jpg").write_bytes(picture_bytes())

    def _videos(self) -> None:
        for suffix, codec in ((".mp4", "libx264"), (".webm", "libvpx-vp9")):
            video = self._add(f"video {suffix}", f"videos/00{suffix}", "info FILE", "check DIR --quick")
            write_numbered_video(video / f"videos/00{suffix}", range(6), codec=codec)
        listed = self._add("list of videos", "videos.json", "check DIR --quick", "info DIR")
        write_numbered_video(listed / "videos" / "00.mp4", range(6))
        size = (listed / "videos" / "00.mp4").stat().st_size
        index = {"width": 32, "height": 48, "frames": 6, "start": "0", "fps": "30", "keyframes": [0]}
        entry = {"file": "00.mp4", "bytes": size, "offset": 0, "index": index}
        (listed / "videos.json").write_text(json.dumps({"version": 2, "fps": "30", "cameras": {"00": entry}}))

    def _runs(self) -> None:
        files = ("config.yaml", "metrics.jsonl", "hull/000000.ply", "hull/bounds.json")
        for name in files:
            run = self._add(f"run {name}", name, "info DIR", "verify DIR", "eval DIR", "export DIR -o OUT.4dv")
            (run / "hull").mkdir(exist_ok=True)
            (run / "config.yaml").write_text(f"capture: {self._folder / 'ball'}\ntrain: {{points: 100}}\n")
            (run / "metrics.jsonl").write_text('{"step": 10, "psnr": 20.5}\n')
            (run / "hull" / "bounds.json").write_text('{"lower": [0, 0, 0], "upper": [1, 1, 1]}')
            shutil.copy(self._folder / "points-ply" / "a.ply", run / "hull" / "000000.ply")

    def _settings(self) -> None:
        config = self._add("overlay", "a.yaml", f"train {self._folder / 'ball'} -o OUT --config FILE --max-steps 0")
        (config / "a.yaml").write_text(to_yaml(SMALL))
        board = self._add("board", "a.toml", "calibrate --board FILE --print-board OUT.pdf")
        text = "columns = 5\nrows = 4\nsquare_m = 0.03\nmarker_m = 0.02\ndictionary = '4X4_50'\n"
        (board / "a.toml").write_text(text)

    def _sources(self) -> None:
        self._source("transforms", "transforms.json", self._write_transforms)
        for file in ("cameras.bin", "images.bin", "points3D.bin"):
            self._source(f"colmap {file}", file, lambda folder: self._write_model(folder, test_colmap.write_binary))
        for file in ("cameras.txt", "images.txt"):
            self._source(f"colmap {file}", file, lambda folder: self._write_model(folder, test_colmap.write_text))
        self._source("qualisys", "a.qca.txt", self._write_qualisys)
        self._source("anipose", "a.toml", lambda folder: _write_table(folder, "a.toml", calibration_toml(1), "ABC"))
        self._source("caliscope", CALISCOPE, lambda folder: _write_table(folder, CALISCOPE, caliscope_toml(), "012"))
        self._source("neural3dv", "poses_bounds.npy", self._write_rows)
        self._source("dna-rendering", "a.smc", self._write_hdf5)

    def _source(self, name: str, file: str, write: Callable[[Path], object]) -> None:
        folder = self._add(f"source {name}", file, "import DIR OUT")
        write(folder)
        assert (folder / file).exists(), file

    def _write_transforms(self, folder: Path) -> None:
        write_pictures(folder, ["0.jpg", "1.jpg"])
        pose = np.eye(4).tolist()
        frames = [{"file_path": f"{index}.jpg", "transform_matrix": pose} for index in range(2)]
        (folder / "transforms.json").write_text(json.dumps({"fl_x": 30.0, "w": 24, "h": 16, "frames": frames}))

    def _write_model(self, folder: Path, write: Callable[..., None]) -> None:
        for index in range(3):
            write_pictures(folder / "images" / f"c{index}", ["0000.jpg"])
        write(folder, test_colmap.images(), "OPENCV")

    def _write_qualisys(self, folder: Path) -> None:
        text = "".join(camera_xml(name, camera) for name, camera in zip("123", uneven_cameras(3), strict=True))
        (folder / "a.qca.txt").write_text(f"<calibration><cameras>{text}</cameras></calibration>")
        for name in "123":
            write_video(folder / f"cam_{name}.mp4")

    def _write_rows(self, folder: Path) -> None:
        np.save(folder / "poses_bounds.npy", test_neural3dv.rows())
        for name in test_neural3dv.NAMES:
            write_video(folder / f"{name}.mp4")

    def _write_hdf5(self, folder: Path) -> None:
        with h5py.File(folder / "a.smc", "w") as file:
            for number, group in test_dna_rendering.IDS.items():
                file[f"{group}/{number}/color/0"] = np.frombuffer(picture_bytes(), np.uint8)
            test_dna_rendering.write_calibration(file)


def _write_table(folder: Path, name: str, text: str, cameras: str) -> None:
    (folder / name).write_text(text)
    for camera in cameras:
        write_video(folder / f"cam{'' if camera.isalpha() else '_'}{camera}.mp4")
