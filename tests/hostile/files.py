"""Generator of hostile files and command lines. Each case is a command that must end with one error line and exit code
2.
"""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors.numpy import save_file

from tests.baking.scenes import write_scene
from tests.captures import write_ball_capture

YAML = "%YAML:1.0\n---\n"
EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 64\n(hostile) print\n"
ESCAPE = "\x1b]0;hostile\x07"


@dataclass(frozen=True)
class Case:
    """A command line and the exit codes that are allowed.

    Attributes:
        name: short description, unique.
        words: the arguments of fourd.
        codes: allowed exit codes. 0 is allowed only if the content is unusual but valid.
    """

    name: str
    words: tuple[str, ...]
    codes: tuple[int, ...] = (2,)


class HostileFiles:
    """Writes hostile files into a folder, and lists the commands that read them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.capture = write_ball_capture(folder / "capture", cameras=3, frames=1)
        self.scene = folder / "whole.4dv"
        write_scene(self.scene, points=20)

    def cases(self) -> Iterator[Case]:
        """All cases. The files of a case are written when the case is requested."""
        for make in (
            self._kinds_of_files,
            self._calibrations,
            self._pictures,
            self._states,
            self._scenes,
            self._runs,
            self._sources,
            self._options,
        ):
            yield from make()

    def _kinds_of_files(self) -> Iterator[Case]:
        """Named pipes and devices in place of files."""
        for kind, make in (("pipe", os.mkfifo), ("device", lambda path: os.symlink("/dev/zero", path))):
            for suffix in (".4dv", ".ply", ".splat", ".glb", ".safetensors", ".mp4"):
                path = self.folder / f"{kind}{suffix}"
                make(path)
                yield Case(f"info of a {kind}{suffix}", ("info", str(path)))
            for suffix in (".4dv", ".ply", ".splat", ".glb"):
                path = str(self.folder / f"{kind}{suffix}")
                yield Case(f"render of a {kind}{suffix}", ("render", path, "--path", "orbit", "--out", self._out()))
            yield Case(f"verify of a {kind}", ("verify", str(self.folder / f"{kind}.4dv")))
            for name in ("intri.yml", "images/00/000000.png", "masks/01/000000.png", "capture.json"):
                broken = self._broken(f"{kind} {name}", name, make)
                yield Case(f"check of a {kind} as {name}", ("check", broken, "--deep"))
            video = self._broken(f"{kind} video", "videos/00.mp4", make, remove="images")
            yield Case(f"check of a {kind} as a video", ("check", video))
            path = self.folder / f"{kind}.json"
            make(path)
            words = ("render", str(self.scene), "--path", str(path), "--out", self._out())
            yield Case(f"render along a {kind}", words)
            words = ("train", str(self.capture), "-o", self._out(), "--config", str(path), "--max-steps", "1")
            yield Case(f"config of a {kind}", words)

    def _calibrations(self) -> Iterator[Case]:
        """YAML that overflows the stack of OpenCV's parser or corrupts memory, and content that is not valid YAML."""
        many = 300_000
        contents = {
            "flow lists": YAML + "a: " + "[" * many + "]" * many,
            "flow maps": YAML + "a: " + "{a:" * many,
            "dashes": YAML + "a:\n  " + "- " * many + "1",
            "joined dashes": YAML + "a:\n  " + "-" * many + "1",
            "keys": YAML + "a: " * many + "1",
            "keys after a list": YAML + "b: [1]\n[" + "a: " * many + "1",
            "closed in strings": YAML + 'a: ["]"\n' * many,
            "indented": YAML + "".join(" " * depth + "a:\n" for depth in range(2000)),
            "vertical tabs": YAML + "a: " + "\x0b- " * many,
            "JSON": '{"a": ' + "[" * many,
            "XML": '<?xml version="1.0"?>\n<opencv_storage>' + "<a>" * many,
            "not UTF-8": YAML + "names: [\udcff]",
            "empty": "",
        }
        for name, content in contents.items():
            for file in ("intri.yml", "extri.yml"):
                written = content.encode("utf-8", "surrogateescape")
                broken = self._broken(f"{name} {file}", file, lambda path, it=written: path.write_bytes(it))
                yield Case(f"check of {name} as {file}", ("check", broken))
        matrix = "K_00: !!opencv-matrix\n   cols: 3\n   dt: d\n   data: [" + "1., " * 100_000 + "1.]\n"
        for name, content in (("overflowing", matrix), ("empty", matrix.replace("cols: 3", "sizes: []"))):
            text = YAML + 'names: ["00", "01", "02", "03"]\n' + content
            broken = self._broken(f"{name} matrix", "intri.yml", lambda path, it=text: path.write_text(it))
            yield Case(f"check of a matrix that is {name}", ("check", broken))
        for name in ("absent", "extri.yml"):
            linked = self._broken(f"link to {name}", "extri.yml", lambda path, it=name: path.symlink_to(it))
            yield Case(f"carve of a calibration that links to {name}", ("carve", linked, "--out", self._out()))
        (self.folder / "loop").symlink_to("loop")
        for command in ("carve", "mesh", "train", "make"):
            line = (command, str(self.folder / "loop"), "-o", self._out())
            yield Case(f"{command} of a link to itself", line)
        yield Case("matte of a link to itself", ("matte", str(self.folder / "loop")))

    def _pictures(self) -> Iterator[Case]:
        """Files with image names whose content is not a supported image, and images that declare a huge size."""
        bomb = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (60_000).to_bytes(4, "big") * 2 + b"\x08\x02\0\0\0" + b"\0" * 40
        for name, content in (("EPS", EPS), ("bomb", bomb), ("GIF", b"GIF89a" + b"\0" * 60), ("empty", b"")):
            for file in ("images/00/000000.png", "masks/00/000000.png"):
                broken = self._broken(f"{name} {file}", file, lambda path, it=content: path.write_bytes(it))
                yield Case(f"check of {name} as {file}", ("check", broken, "--deep"))
                yield Case(f"carve of {name} as {file}", ("carve", broken, "--out", self._out()))

    def _states(self) -> Iterator[Case]:
        """State files of captures, and symbolic links to paths outside the capture."""
        contents = {"deep": "[" * 200_000, "number": '{"version": 1, "fps": ' + "9" * 5000 + "}", "text": '"a"'}
        contents["exponent"] = '{"version": 1, "fps": "1e99999999"}'
        for name, content in contents.items():
            broken = self._broken(f"{name} rate", "capture.json", lambda path, it=content: path.write_text(it))
            yield Case(f"check of a rate with {name}", ("check", broken))
        outside = self.folder / "outside"
        outside.mkdir(exist_ok=True)
        (outside / "precious").write_text("kept")
        for name in (".fourd", ".fourd/mattes"):
            linked = self._broken(f"link {name}", name, lambda path: path.symlink_to(outside), remove="masks")
            yield Case(f"matte with a link as {name}", ("matte", linked))
        named = self._broken(f"name {ESCAPE}", f"images/{ESCAPE}/000000.png", lambda path: path.write_bytes(EPS))
        yield Case("check of names with escape sequences", ("check", named))

    def _scenes(self) -> Iterator[Case]:
        """Scenes whose manifest declares huge or wrong values."""
        for name, change in {
            "cameras of 2^32 pixels": lambda it: _resize(it, 65536),
            "cameras of 2^28 pixels": lambda it: _resize(it, 16384),
            "a million frames": lambda it: it.update(frames=it["frames"] * 1_000_000),
            "a billion points": lambda it: it["frames"][0].update(points=1 << 26),
            "huge layers": lambda it: it.update(layers=10**8),
            "nan": lambda it: it.update(near=float("nan")),
            "other types": lambda it: it.update(frames={"a": []}),
        }.items():
            path = self._changed_scene(name, change)
            yield Case(f"info of {name}", ("info", path))
            yield Case(f"render of {name}", ("render", path, "--path", "orbit", "--out", self._out(), "--steps", "1"))
        path = self._changed_scene(ESCAPE, lambda it: it.update(producer=ESCAPE))
        yield Case("info of escape sequences", ("info", path))
        cut = self.folder / "cut.4dv"
        cut.write_bytes(self.scene.read_bytes()[:-200])
        yield Case("verify of a truncated scene", ("verify", str(cut)))
        content = bytearray(self.scene.read_bytes())
        content[200] ^= 1
        flipped = self.folder / "flipped.4dv"
        flipped.write_bytes(content)
        yield Case("verify of a flipped bit", ("verify", str(flipped)))

    def _runs(self) -> Iterator[Case]:
        """Settings and checkpoints of runs."""
        levels = "\n".join(f"l{index}: &l{index} [{','.join([f'*l{index - 1}'] * 10)}]" for index in range(1, 10))
        contents = {
            "aliases": "l0: &l0 [1]\n" + levels,
            "tags": "capture: !!python/object/apply:os.system ['true']",
            "deep": "a: " + "[" * 100_000,
            "large": "#" * (2 << 20),
            "number": "train: {seed: " + "9" * 5000 + "}",
        }
        for name, content in contents.items():
            run = self.folder / f"run {name}"
            run.mkdir()
            (run / "config.yaml").write_text(content)
            for command in ("info", "verify", "eval"):
                codes = (0, 2) if command == "info" and name in ("aliases", "number", "tags") else (2,)
                yield Case(f"{command} of a run with {name}", (command, str(run)), codes)
        header = self.folder / "header.safetensors"
        header.write_bytes((1 << 60).to_bytes(8, "little") + b"{}")
        yield Case("info of a checkpoint with a huge header", ("info", str(header)))
        run = self.folder / "run checkpoint"
        (run / "checkpoints").mkdir(parents=True)
        (run / "config.yaml").write_text("{}")
        save_file({}, run / "checkpoints" / "00000001.safetensors", {"format": "fourd-checkpoint-1", "digest": "0"})
        yield Case("verify of a wrong digest", ("verify", str(run)))

    def _sources(self) -> Iterator[Case]:
        """Files of other programs for fourd import."""
        frame = {"file_path": ".", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
        contents: dict[str, dict[str, Any] | str] = {
            "a folder as a frame": {"fl_x": 50, "w": 64, "h": 64, "frames": [frame]},
            "a huge size": {"fl_x": 50, "w": 1 << 20, "h": 1 << 20, "frames": [{**frame, "file_path": "a.png"}]},
            "deep JSON": "[" * 200_000,
        }
        for name, content in contents.items():
            source = self.folder / f"source {name}"
            source.mkdir()
            text = content if isinstance(content, str) else json.dumps(content)
            (source / "transforms.json").write_text(text)
            yield Case(f"import of {name}", ("import", str(source), self._out()))
        source = self.folder / "source playlist"
        source.mkdir()
        for name in ("00.mp4", "01.mp4"):
            (source / name).write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n")
        # An import of videos writes a record into its output folder, and a later import into the same folder would
        # continue the first import. The import of the playlist therefore has its own output folder.
        yield Case("import of a playlist", ("import", str(source), self._out() + " of a playlist"))
        yield Case("info of a playlist", ("info", str(source / "00.mp4")))

    def _options(self) -> Iterator[Case]:
        """Values of options that are out of range."""
        render = ("render", str(self.scene), "--path", "orbit", "--out", self._out())
        for words in (
            ("--layers", "0"),
            ("--layers", "100000000"),
            ("--size", "0", "0"),
            ("--size", "-5", "5"),
            ("--size", "1000000", "1000000"),
            ("--steps", "-1"),
            ("--fps", "0"),
            ("--fps", "nan"),
            ("--background", "nan", "0", "0"),
            ("--frames", "5:1"),
            ("--frames", "9" * 5000),
            ("--style", ESCAPE),
        ):
            yield Case(f"render with {' '.join(words)[:40]}", (*render, *words))
        for path in ("[/x]", ESCAPE, "a\nb", "\udcff"):
            yield Case(f"info of the path {path!r}", ("info", str(self.folder / path)))
        train = ("train", str(self.capture), "-o", self._out(), "--max-steps", "1")
        for setting in ("points=1000000000000000000", "model.hidden=1000000000", f"seed={'9' * 5000}", "layers=0"):
            yield Case(f"train with {setting[:40]}", (*train, "--set", setting))

    def _broken(self, name: str, file: str, write: Callable[[Path], object], remove: str | None = None) -> str:
        """Copy the capture, and replace one of its files."""
        safe = "".join(letter if letter.isalnum() else "_" for letter in name)
        copy = self.folder / f"capture {safe}"
        shutil.copytree(self.capture, copy)
        if remove is not None:
            shutil.rmtree(copy / remove)
        (copy / file).parent.mkdir(parents=True, exist_ok=True)
        (copy / file).unlink(missing_ok=True)
        write(copy / file)
        return str(copy)

    def _changed_scene(self, name: str, change: Callable[[dict[str, Any]], object]) -> str:
        safe = "".join(letter if letter.isalnum() else "_" for letter in name)
        path = self.folder / f"{safe}.4dv"
        with zipfile.ZipFile(self.scene) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as new:
            for member in old.namelist():
                content = old.read(member)
                if member == "manifest.json":
                    manifest = json.loads(content)
                    change(manifest)
                    content = json.dumps(manifest).encode()
                new.writestr(member, content)
        return str(path)

    def _out(self) -> str:
        return str(self.folder / "out")


def _resize(manifest: dict[str, Any], side: int) -> None:
    for view in manifest["source_views"]:
        view.update(width=side, height=side)
