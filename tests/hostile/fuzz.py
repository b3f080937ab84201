"""Fuzz the readers of files with coverage feedback (atheris): python -m tests.hostile.fuzz [--seconds N] [READER ...]

Each reader runs in its own process for an equal share of the time. The corpus of inputs of each reader grows in
build/fuzz/. A reader fails on an input if it raises an exception other than UserError, hangs for 60 seconds or needs 2
GB of memory. An input on which a reader fails is written to build/fuzz/READER-crash-HASH. Fix the reader, and add a
case with an input of this kind to tests/hostile/.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import FunctionType

import atheris

from fourd.base.configs import load_overlay
from fourd.base.errors import UserError
from fourd.base.formats.ply import read_ply
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.boards import read_board
from fourd.recording.capture.calibration import check_calibration
from fourd.recording.capture.decoding import decode_rgb
from fourd.recording.capture.streams.matroska import missing_bytes
from fourd.recording.capture.video_list import list_videos
from fourd.recording.importing.formats import actorshq, anipose, caliscope, neural3dv, qualisys, transforms_json
from fourd.scene.splats.dgs_reader import DgsReader
from fourd.scene.splats.reader import SplatReader
from fourd.viewer.camera_paths.reading import read_path
from tests.baking.scenes import read_frames
from tests.viewer.camera_paths.exports import SCENE

FOLDER = Path("build") / "fuzz"
MAX_SECONDS = 60
"""Time in seconds after which a reader counts as hanging. A busy machine can stop a process for 20 seconds."""
GRACE_SECONDS = 120
"""Seconds after which a reader's process is ended if libFuzzer does not end it."""
MAX_BYTES = 1 << 16
"""Maximum size in bytes of an input."""


def read_scene(path: Path) -> None:
    read_frames(path, 2)


def read_splats(path: Path) -> None:
    SplatReader(path).read(0)


def read_moving_splats(path: Path) -> None:
    with closing(DgsReader(path)) as reader:
        reader.read(0)


def read_camera_path(path: Path) -> None:
    read_path(path, SCENE).with_count(3)


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "scene": ("a.4dv", read_scene),
    "points": ("a.ply", read_ply),
    "splats": ("a.ply", read_splats),
    "raw-splats": ("a.splat", read_splats),
    "moving-splats": ("a.4dgs", read_moving_splats),
    "calibration": ("intri.yml", lambda path: check_calibration(path.parent)),
    "picture": ("a.png", decode_rgb),
    "matroska": ("a.mkv", missing_bytes),
    "videos": ("videos.json", lambda path: list_videos(path.parent)),
    "overlay": ("a.yaml", lambda path: load_overlay(TrainConfig(), path)),
    "board": ("a.toml", read_board),
    "path": ("a.json", read_camera_path),
    "transforms": ("transforms.json", lambda path: transforms_json.read(path.parent)),
    "qualisys": ("a.qca.txt", qualisys.read_cameras),
    "anipose": ("a.toml", anipose.read_cameras),
    "caliscope": ("camera_array.toml", caliscope.read_cameras),
    "actorshq": ("calibration.csv", actorshq.read_cameras),
    "neural3dv": ("poses_bounds.npy", lambda path: neural3dv.read(path.parent)),
}
"""The file name and the function of each reader."""


def instrument() -> None:
    """Instrument all imported functions of fourd, so that atheris can measure their coverage."""
    for module in [module for name, module in sys.modules.items() if name.startswith("fourd.")]:
        values = list(vars(module).values())
        values += [value for kind in values if isinstance(kind, type) for value in vars(kind).values()]
        for value in values:
            if isinstance(value, FunctionType) and value.__module__.startswith("fourd."):
                atheris.instrument_func(value)


def fuzz(name: str, options: list[str]) -> None:
    """Fuzz one reader in this process, until libFuzzer ends the process."""
    file, read = READERS[name]
    folder = Path(tempfile.mkdtemp(prefix="fourd-fuzz-"))
    path = folder / file
    if name == "calibration":
        (folder / "extri.yml").write_text('%YAML:1.0\n---\nnames: ["0"]\n')

    def test_one_input(content: bytes) -> None:
        path.write_bytes(content)
        try:
            read(path)
        except UserError as error:
            if "\n" in str(error):
                raise

    instrument()
    atheris.Setup([sys.argv[0], *options], test_one_input)
    atheris.Fuzz()


def write_seeds() -> None:
    """Write the undamaged sample files of the tests as the first inputs of the corpora."""
    from tests.hostile.samples import Samples

    with tempfile.TemporaryDirectory() as folder:
        for sample in Samples(Path(folder)).all:
            content = (sample.folder / sample.file).read_bytes()
            for name, (file, _) in READERS.items():
                if Path(file).suffix == Path(sample.file).suffix and len(content) <= MAX_BYTES:
                    (FOLDER / name).mkdir(parents=True, exist_ok=True)
                    (FOLDER / name / sample.folder.name).write_bytes(content)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=60, help="time in seconds for all readers together")
    parser.add_argument("--child", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"default: all of {', '.join(READERS)}")
    arguments = parser.parse_args()
    if arguments.child:
        fuzz(arguments.child[0], arguments.child[1:])
        return 0
    names = arguments.readers or list(READERS)
    write_seeds()
    failed = []
    for name in names:
        (FOLDER / name).mkdir(parents=True, exist_ok=True)
        share = max(1, arguments.seconds // len(names))
        options = [f"-max_total_time={share}", f"-max_len={MAX_BYTES}", f"-timeout={MAX_SECONDS}"]
        options += ["-rss_limit_mb=2048", "-print_final_stats=0", "-verbosity=0", f"-artifact_prefix={FOLDER / name}-"]
        command = [sys.executable, "-m", "tests.hostile.fuzz", "--child", name, str(FOLDER / name), *options]
        # libFuzzer can hang in its signal handler, and the process then does not end.
        try:
            code = subprocess.run(command, check=False, timeout=share + GRACE_SECONDS).returncode
        except subprocess.TimeoutExpired:
            code = None
        print(f"{name}: {'ended late' if code is None else 'ok' if code == 0 else 'failed'}", flush=True)
        failed += [name] if code else []
    return 2 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
