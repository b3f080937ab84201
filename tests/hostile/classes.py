"""Hostile files that are written in the formats of several programs. Examples are files with numbers that are not
finite, with counts that do not match the content, and with YAML aliases.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import h5py
import numpy as np
import zstandard

from fourd.scene.packing.pack import pack_scene
from tests.baking.fuzz.rewrite import rewrite_members
from tests.capture.numbered_videos import write_slow_video
from tests.hostile.files import Case, HostileFiles
from tests.importing.formats.sources import WIDTH, picture_bytes, uneven_cameras, write_pictures
from tests.importing.formats.sources import write_video as write_small_video
from tests.importing.formats.test_colmap import images as colmap_images
from tests.importing.formats.test_colmap import write_binary, write_text
from tests.importing.formats.test_qualisys import camera_xml

BAD_NUMBERS = ("nan", "inf", "-inf", "1e400", "1e308", "-1e308", "0", "-0", "9" * 5000, "", "0x10", "1_0", "\u0661")
NAME = b"caf\xe9"


class HostileClasses:
    """Writes the files into the folder of ``files``, and lists the commands that read them."""

    def __init__(self, files: HostileFiles) -> None:
        self.files = files
        self.folder = files.folder / "classes"
        self.folder.mkdir()
        self._count = 0

    def cases(self) -> Iterator[Case]:
        """All cases. The files of a case are written when the case is requested."""
        for make in (
            self._qualisys,
            self._arrays,
            self._aliases,
            self._video_lists,
            self._frame_rates,
            self._models,
            self._hdf5,
            self._logs,
            self._bombs,
            self._outputs,
            self._names,
        ):
            yield from make()

    def _new(self) -> Path:
        self._count += 1
        folder = self.folder / str(self._count)
        folder.mkdir()
        return folder

    def _out(self) -> str:
        return str(self.folder / "out")

    def _import(self, name: str, source: Path) -> Case:
        return Case(f"import of {name}", ("import", str(source), self._out()))

    def _qualisys(self) -> Iterator[Case]:
        text = camera_xml("1", uneven_cameras(1)[0])
        attributes = ('right="', 'left="', 'focalLengthU="', 'r11="', 'x="', 'radialDistortion1="', 'skew="')
        for attribute in attributes:
            for number in BAD_NUMBERS[:9]:
                source = self._new()
                start = text.index(attribute) + len(attribute)
                changed = text[:start] + number + text[text.index('"', start) :]
                (source / "a.qca.txt").write_text(f"<calibration><cameras>{changed}</cameras></calibration>")
                write_small_video(source / "a_1.mp4")
                if number in ("0", "-0") and attribute not in ('right="', 'focalLengthU="'):
                    continue
                yield self._import(f"Qualisys with {attribute}{number[:9]}", source)

    def _arrays(self) -> Iterator[Case]:
        headers = {
            "unary signs": "{'descr': '<f8', 'fortran_order': False, 'shape': (" + "-" * 5000 + "1, 17)}",
            "parentheses": "{'descr': '<f8', 'fortran_order': False, 'shape': " + "(" * 5000 + "1" + ")" * 5000 + "}",
            "a huge shape": "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 17)}",
            "an overflow": "{'descr': '<f8', 'fortran_order': False, 'shape': (4611686018427387904, 17)}",
            "a negative shape": "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 17)}",
            "objects": "{'descr': '|O', 'fortran_order': False, 'shape': (1, 17)}",
            "a nested type": "{'descr': [('a', " + "[('a', " * 50 + "'<f8'" + ")]" * 50 + ")], 'shape': (1,)}",
            "a large type": "{'descr': '|V2147483647', 'fortran_order': False, 'shape': (1, 17)}",
        }
        for name, header in headers.items():
            source = self._new()
            write_small_video(source / "cam00.mp4")
            text = header.encode().ljust(len(header) // 64 * 64 + 64 - 13) + b"\n"
            (source / "poses_bounds.npy").write_bytes(b"\x93NUMPY\x02\0" + struct.pack("<I", len(text)) + text)
            yield self._import(f"an array with {name}", source)

    def _aliases(self) -> Iterator[Case]:
        levels = "\n".join(f"l{index}: &l{index} [{','.join([f'*l{index - 1}'] * 10)}]" for index in range(1, 10))
        for key in ("capture: *l9", "train: {test_views: *l9}", "train: {frames: *l9}", "*l9 : 1"):
            run = self._new()
            (run / "config.yaml").write_text(f"l0: &l0 [1]\n{levels}\n{key}\n")
            for command in ("info", "verify", "eval"):
                yield Case(f"{command} of a run with the alias {key}", (command, str(run)), (0, 2))
        style = self._new() / "style.yaml"
        style.write_text(f"l0: &l0 [1]\n{levels}\nramp: *l9\n")
        render = ("render", str(self.files.scene), "--path", "orbit", "--out", self._out(), "--style", str(style))
        yield Case("a style with aliases", render)

    def _video_lists(self) -> Iterator[Case]:
        video = self.folder / "00.mp4"
        write_small_video(video, frames=4)
        size = video.stat().st_size
        whole = {"width": WIDTH, "height": 16, "frames": 4, "start": "0", "fps": "25", "keyframes": [0]}
        changes: dict[str, dict[str, object]] = {
            "10^12 frames": {"frames": 10**12},
            "10^30 frames": {"frames": 10**30},
            "half a frame": {"frames": 1.5},
            "text as frames": {"frames": "4"},
            "a huge width": {"width": 10**9},
            "a wrong width": {"width": 1 << 15, "height": 1 << 15},
            "no keyframes": {"keyframes": []},
            "keyframes outside": {"keyframes": [10**12]},
            "a huge rate": {"fps": "1" + "0" * 60},
            "a small rate": {"fps": "1/1" + "0" * 60},
            "a huge start": {"start": "1" + "0" * 60},
            "times that are not increasing": {"times": [3, 2, 1, 0], "tick": "1/25"},
            "huge times": {"times": [0, 1, 2, 10**300], "tick": "1/25"},
            "a scale": {"scale": 1e-300},
            "nan as scale": {"scale": float("nan")},
            "another key": {"hostile": 1},
        }
        for name, change in changes.items():
            for place in ("videos.json", ".fourd/videos.json"):
                text = json.dumps(
                    {
                        "version": 2,
                        "cameras": {"00": {"file": "00.mp4", "bytes": size, "offset": 0, "index": whole | change}},
                    }
                )

                def write(path: Path, text: str = text) -> None:
                    path.write_text(text)
                    target = path.parents[1 if path.parent.name == ".fourd" else 0] / "videos" / "00.mp4"
                    target.parent.mkdir()
                    target.write_bytes(video.read_bytes())

                broken = self.files._broken(f"list {name} {place}", place, write, remove="images")
                yield Case(f"check of {place} with {name}", ("check", broken), (2,))
                yield Case(f"info of {place} with {name}", ("info", broken), (0, 2))

    def _frame_rates(self) -> Iterator[Case]:
        for name, seconds in (("an hour", 3600), ("a year", 31_536_000), ("a microsecond", Fraction(1, 10**6))):
            source = self._new()
            for camera in ("00", "01"):
                write_slow_video(source / f"{camera}.mkv", Fraction(seconds))
            yield Case(f"info of frames each {name}", ("info", str(source / "00.mkv")), (0, 2))
            yield Case(f"import of frames each {name}", ("import", str(source), self._out() + name, "--copy"), (0, 2))

    def _models(self) -> Iterator[Case]:
        lies = {
            "a count of 2^63": 1 << 63,
            "a count of 2^40": 1 << 40,
            "a count of 2^30": 1 << 30,
            "a count of 1000": 1000,
        }
        for name, count in lies.items():
            for file in ("frames.bin", "points3D.bin", "rigs.bin", "cameras.bin", "images.bin"):
                source = self._colmap()
                content = (source / file).read_bytes() if (source / file).exists() else struct.pack("<Q", 0)
                (source / file).write_bytes(struct.pack("<Q", count) + content[8:] + bytes(9000))
                yield Case(f"import of {file} with {name}", ("import", str(source), self._out()), (0, 2))
        for name, track in (("a track of 2^60", 1 << 60), ("a track of 2^31", 1 << 31)):
            source = self._colmap()
            point = struct.pack("<QdddBBBdQ", 1, 0, 0, 0, 1, 1, 1, 0.5, track) + bytes(4000)
            (source / "points3D.bin").write_bytes(struct.pack("<Q", 1) + point)
            yield self._import(f"points with {name}", source)
        for name, text in {"nan": "nan", "inf": "inf", "1e400": "1e400"}.items():
            source = self._new()
            for index in range(3):
                write_pictures(source / "images" / f"c{index}", ["0000.jpg"])
            write_text(source, colmap_images())
            lines = (source / "images.txt").read_text().splitlines()
            words = lines[1].split()
            lines[1] = " ".join([words[0], text, *words[2:]])
            (source / "images.txt").write_text("\n".join(lines) + "\n")
            yield self._import(f"a model with {name}", source)

    def _colmap(self) -> Path:
        source = self._new()
        for index in range(3):
            write_pictures(source / "images" / f"c{index}", ["0000.jpg"])
        write_binary(source, colmap_images(), "OPENCV")
        return source

    def _hdf5(self) -> Iterator[Case]:
        for name in ("a huge image", "a group cycle", "a huge matrix", "many names"):
            source = self._new()
            with h5py.File(source / "a.smc", "w") as file:
                file["Camera_5mp/0/color/0"] = np.frombuffer(picture_bytes(), np.uint8)
                file["Camera_5mp/1/color/0"] = np.frombuffer(picture_bytes(), np.uint8)
                for number in ("00", "01"):
                    file[f"Camera_Parameter/{number}/K"] = np.eye(3)
                    file[f"Camera_Parameter/{number}/D"] = np.zeros(5)
                    file[f"Camera_Parameter/{number}/RT"] = np.eye(4)
                if name == "a huge image":
                    del file["Camera_5mp/0/color/0"]
                    shape = (1 << 40,)
                    dataset = file.create_dataset("Camera_5mp/0/color/0", shape, np.uint8, chunks=(1 << 20,))
                    head = picture_bytes()
                    dataset[: len(head)] = np.frombuffer(head, np.uint8)
                elif name == "a group cycle":
                    file["Camera_5mp/2"] = file["Camera_5mp"]
                elif name == "a huge matrix":
                    del file["Camera_Parameter/00/D"]
                    file.create_dataset("Camera_Parameter/00/D", (1 << 40,), np.float64, chunks=(1 << 20,))
                else:
                    for number in range(20_000):
                        file.create_group(f"Camera_Parameter/{number + 100}")
            yield Case(f"import of HDF5 with {name}", ("import", str(source), self._out()), (0, 2))

    def _logs(self) -> Iterator[Case]:
        contents = {"deep": "[" * 100_000, "digits": '{"step": 1, "psnr": ' + "9" * 5000 + "}", "line": "x" * (1 << 20)}
        contents["escape"] = '{"step": 1, "\\u001b]0;x\\u0007": 1}'
        for name, content in contents.items():
            run = self._new()
            (run / "config.yaml").write_text("{}")
            (run / "metrics.jsonl").write_text(content + "\n")
            yield Case(f"info of a log with {name}", ("info", str(run)), (0, 2))
        for name in ("metrics.jsonl", "hull/000000.ply", "checkpoints/00000001.safetensors"):
            run = self._new()
            (run / "config.yaml").write_text("{}")
            (run / name).parent.mkdir(exist_ok=True)
            os.mkfifo(run / name)
            yield Case(f"info of a run with a pipe as {name}", ("info", str(run)), (0, 2))
            yield Case(f"verify of a run with a pipe as {name}", ("verify", str(run)))

    def _bombs(self) -> Iterator[Case]:
        packed = self.folder / "packed.4dv"
        pack_scene(self.files.scene, packed, "light")
        bomb = self.folder / "bomb.4dv"
        points = (1 << 26) - 1

        def enlarge(members: dict[str, bytes]) -> None:
            manifest = json.loads(members["manifest.json"])
            manifest["frames"][0]["points"] = points
            members["manifest.json"] = json.dumps(manifest).encode()
            for name in [name for name in members if name.startswith("frames/000000/")]:
                old = zstandard.ZstdDecompressor().decompress(members[name])
                size = len(old) // 200 * points
                compressor = zstandard.ZstdCompressor(level=1).compressobj(size=size)
                blocks = [compressor.compress(bytes(min(1 << 26, size - at))) for at in range(0, size, 1 << 26)]
                members[name] = b"".join(blocks) + compressor.flush()

        rewrite_members(packed, bomb, enlarge)
        render = ("--path", "orbit", "--out", self._out(), "--steps", "1")
        yield Case("render of a bomb of points", ("render", str(bomb), *render))
        yield Case("verify of a bomb of points", ("verify", str(bomb)), (0, 2))

    def _outputs(self) -> Iterator[Case]:
        scene = str(self.files.scene)
        for name, make in (
            ("a pipe", os.mkfifo),
            ("a device", lambda path: os.symlink("/dev/full", path)),
            ("a folder", os.mkdir),
            ("a socket", make_socket),
        ):
            for suffix in (".png", ".mp4", ".4dv", ".json"):
                target = self._new() / f"target{suffix}"
                make(target)
                words = {
                    ".png": ("view", scene, "--screenshot", str(target), "--renderer", "cpu"),
                    ".mp4": ("render", scene, "--path", "orbit", "--steps", "1", "-o", str(target)),
                    ".4dv": ("pack", scene, "-o", str(target)),
                    ".json": ("bench", "--quick", "--json", str(target)),
                }[suffix]
                if suffix == ".json":
                    continue
                yield Case(f"{name} as output {suffix}", words)

    def _names(self) -> Iterator[Case]:
        name = os.fsdecode(NAME)
        capture = self.folder / name / "capture"
        capture.parent.mkdir()
        capture.symlink_to(self.files.capture)
        run = str(self.folder / "run of names")
        for words in (
            ("check", str(capture)),
            ("carve", str(capture), "-o", run + "1", "--points", "100"),
            ("train", str(capture), "-o", run + "2", "--max-steps", "1"),
            ("import", "easymocap", str(capture), run + "3"),
            ("info", str(capture)),
            ("make", str(capture), "-o", run + "4.4dv", "--max-steps", "1"),
            ("render", str(self.files.scene), "--path", "orbit", "--steps", "1", "-o", str(self.folder / name / "o")),
            ("export", str(self.files.scene), "--to", "ply", "-o", str(self.folder / name / "p")),
            ("pack", str(self.files.scene), "-o", str(self.folder / name / "p.4dv")),
            ("web", str(self.files.scene), "-o", str(self.folder / name / "web")),
        ):
            yield Case(f"{words[0]} with a name that is not UTF-8", words, (0, 2))
        for camera in (name, "a\nb", "[red]x", "a" * 200, "-x", "%s", "{0}"):
            broken = self.files._broken(f"camera {camera!r}", f"images/{camera}/000000.png", write_png)
            yield Case(f"check of the camera {camera!r}", ("check", broken), (2,))


def write_png(path: Path) -> None:
    path.write_bytes(picture_bytes(".png"))


def make_socket(path: Path) -> None:
    import socket

    here = os.getcwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(path.name)
    finally:
        os.chdir(here)
