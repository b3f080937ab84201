"""Describe a file or folder: a scene, a capture, a run, points, a checkpoint, a video, or (--system) this
machine."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
import yaml
from rich.table import Table
from rich.text import Text

from fourd.base.errors import UserError, command_line
from fourd.base.files import list_folder, sort_names
from fourd.base.limits import MAX_CONFIG_BYTES, open_regular, read_limited, require_regular
from fourd.base.processes.isolation import ParserProcess
from fourd.base.progress import Terminal
from fourd.base.storage import Location, StorageUrl
from fourd.cli.locations import PATH_OR_URL, scene_or_copy
from fourd.cli.options import option
from fourd.cli.outputs import READS
from fourd.cli.scenes.description.captures import last_metrics, quality_lines, split_and_masks
from fourd.cli.scenes.description.folders import SITE_SCENE, describe_parts, folder_bytes, is_site, is_work_folder
from fourd.cli.scenes.description.values import (
    bytes_text,
    count_text,
    names_text,
    numbers_text,
    sizes_text,
    span_text,
    unit_text,
    vector_text,
)
from fourd.reconstruction.training.run_layout import CHECKPOINTS, checkpoint_files, segment_folders
from fourd.recording.capture.frame_rate import UNKNOWN_RATE, format_rate
from fourd.recording.capture.layout import PICTURE_SUFFIXES, VIDEO_SUFFIXES, camera_folders

if TYPE_CHECKING:
    from fourd.scene.files.sound import SceneSound
    from fourd.scene.scene import SceneBackground

Rows = list[tuple[str, str]]

_MOST_HEADER = 100 << 20
CAPTURE_TITLE = "a multi-view capture"
SITE_TITLE = "a web page that plays a scene"
NEXT = {CAPTURE_TITLE: "check", SITE_TITLE: "serve"}
"""The command that may come next, for some kinds of folders."""
_MOST_TEXT = 1000
"""Maximum number of characters of a text from a file that are shown."""


@dataclass(frozen=True)
class Arguments:
    """The type of the file or folder is detected from its content. No file is changed."""

    path: tyro.conf.Positional[Annotated[Location | None, READS, PATH_OR_URL, option("[FILE|DIR]", "none")]] = None
    """A .4dv, .4dgs, .ply, .safetensors or video file, a capture folder or a run folder, or the URL of one."""
    system: bool = False
    """Describe this installation and this machine, for reports of problems."""


def run(arguments: Arguments) -> None:
    """Detect the type, read the headers and print a table."""
    if arguments.system:
        from fourd.cli.scenes.description.system import describe_system

        _print_table("this installation", describe_system())
    if arguments.path is not None:
        _describe_path(arguments.path)
    elif not arguments.system:
        raise UserError("FILE|DIR: expected a file or a folder, got none; name one, or add --system")


def _describe_path(source: Location) -> None:
    with scene_or_copy(source) as path:
        if isinstance(path, Path) and not path.exists():
            raise UserError(f"{path}: expected a file or a folder, got a path that does not exist; check the name")
        title, rows = _describe(path)
    location = str(source)
    # A file in an object store such as S3 is read from a local copy. Show the file's URL, because the user does not
    # know the path of the copy.
    _print_table(f"{location}: {title}", [(name, value.replace(str(path), location)) for name, value in rows])
    command = NEXT.get(title)
    if command is not None:
        # Not in the table, whose lines are broken at the width of the terminal.
        Terminal().print(f"next: {command_line('fourd', command, source)}", soft_wrap=True)


def _print_table(heading: str, rows: Rows) -> None:
    table = Table(title=Text(heading), title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(name, Text(value))
    Terminal().print(table)


def _describe(path: Location) -> tuple[str, Rows]:
    if isinstance(path, StorageUrl):
        return "a 4D scene", _scene(path)
    return _describe_folder(path) if path.is_dir() else _describe_file(path)


def _describe_file(path: Path) -> tuple[str, Rows]:
    try:
        with open_regular(path) as stream:
            head = stream.read(16)
    except OSError as error:
        raise UserError(f"{path}: expected a readable file, got '{error.strerror}'; check its permissions") from error
    # Scene files, also truncated ones, start with the bytes PK.
    if head.startswith(b"PK") or path.suffix == ".4dv":
        return "a 4D scene", _scene(path)
    if path.suffix.lower() == ".4dgs":
        return "Gaussian splats over time", _splats(path)
    if path.suffix.lower() == ".splat":
        return "Gaussian splats", _splats(path)
    if head.startswith((b"ply\n", b"ply\r")):
        return "points (PLY)", _points(path)
    if path.suffix == ".safetensors":
        return "a checkpoint", _checkpoint(path)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        with ParserProcess() as parser:
            return "a video", _video(path, parser)
    raise _unknown(path)


def _describe_folder(path: Path) -> tuple[str, Rows]:
    if (path / "config.yaml").is_file():
        return "a training run", _run(path)
    signs = ("images", "videos", "intri.yml", "extri.yml")
    if any((path / sign).exists() for sign in signs):
        return CAPTURE_TITLE, _capture(path)
    videos = [path / name for name in list_folder(path) if Path(name).suffix.lower() in VIDEO_SUFFIXES]
    if is_site(path):
        return SITE_TITLE, [*_scene(path / SITE_SCENE), ("size of the page", bytes_text(folder_bytes(path)))]
    if is_work_folder(path):
        return "the work folder of fourd make", describe_parts(path, _title)
    if any(path.glob("*.4dv")):
        parts = describe_parts(path, _title)
        return f"a folder with {count_text(len(parts), 'thing')} that fourd knows", parts
    if videos:
        with ParserProcess() as parser:
            lines = [(file.name, "; ".join(value for _, value in _video(file, parser))) for file in videos]
        return "a folder of videos", lines
    if any(file.suffix.lower() in (".ply", ".splat") for file in path.iterdir()):
        return "points or Gaussian splats, one file for each frame", _splats(path)
    parts = describe_parts(path, _title)
    if parts:
        return f"a folder with {count_text(len(parts), 'thing')} that fourd knows", parts
    raise _unknown(path)


def _title(path: Path) -> str | None:
    """Return what a file or folder is, without its content, or None if fourd does not know it."""
    try:
        return _describe(path)[0]
    except UserError:
        return None


def _unknown(path: Path) -> UserError:
    return UserError(
        f"{path}: expected a .4dv, .4dgs, .ply, .safetensors or video file, a capture (images/, intri.yml, extri.yml) "
        "or a run (config.yaml), got none of these; name one of them"
    )


def _scene(path: Location) -> Rows:
    from fourd.scene.container import SceneReader

    reader = SceneReader(path)
    reader.close()
    manifest = reader.manifest
    points = manifest.points
    size = reader.size
    frames = manifest.frame_count
    seconds, numbers = frames / manifest.fps, numbers_text(manifest.frame_numbers)
    lower, upper = manifest.bounds
    packed = "" if manifest.encoding is None else f"packed, tier {manifest.encoding.tier}, "
    background_bytes = manifest.background_nbytes if manifest.encoding is None else 0
    return [
        ("format", f"version {manifest.version}, {packed}made by {manifest.producer}"),
        ("kind", "the object alone" if manifest.kind == "object" else "object and background"),
        ("frames", f"{frames} at {format_rate(manifest.fps)} per second, {seconds:.2f} s; {numbers}"),
        *([] if manifest.is_fps_known else [("frame rate", "assumed: the scene does not state the recording's rate")]),
        ("points", f"{span_text(points)} per frame, {sum(points):,} in total"),
        *_background(manifest.background),
        *_sound(manifest.sound),
        ("size", f"{bytes_text(size)}, {bytes_text((size - background_bytes) / max(frames, 1))} per frame"),
        ("source views", f"{manifest.view_count} ({manifest.neighbours} blended): {names_text(manifest.source_names)}"),
        ("other views", names_text(manifest.other_names) or "none"),
        ("image sizes", sizes_text((camera.width, camera.height) for camera in manifest.cameras) or "none"),
        ("layers", f"{manifest.layers} points composited per pixel"),
        ("bounds", f"{vector_text(lower)} to {vector_text(upper)}, in world units"),
        ("focus", vector_text(manifest.focus)),
        ("world unit", unit_text(manifest.metres_per_unit)),
    ]


def _background(background: SceneBackground | None) -> Rows:
    if background is None:
        return []
    shadow = "with a shadow in every frame" if background.shadow else "without shadows"
    return [("background", f"{background.points:,} points, stored once, {shadow}")]


def _sound(sound: SceneSound | None) -> Rows:
    if sound is None:
        return []
    channels = "stereo" if sound.channels == 2 else "mono"
    start = f" from {sound.start:.2f} s" if sound.start else ""
    return [("sound", f"{sound.duration:.2f} s{start}, Opus, {channels}, {bytes_text(sound.bytes)}")]


def _splats(path: Path) -> Rows:
    from fourd.scene.splats.reader import open_reader

    with closing(open_reader(path)) as reader:
        manifest = reader.manifest
    lower, upper = manifest.bounds
    known = "" if manifest.is_fps_known else ", an assumed rate"
    return [
        ("frames", f"{manifest.frame_count} at {format_rate(manifest.fps)} per second{known}"),
        ("points", f"{span_text(manifest.points)} per frame"),
        ("bounds of most points", f"{vector_text(lower)} to {vector_text(upper)}, in world units"),
    ]


def _points(path: Path) -> Rows:
    from fourd.base.formats.ply import read_ply
    from fourd.scene.splats.ply import is_splat_ply

    xyz, rgb = read_ply(path)
    rows = [("points", f"{len(xyz):,}"), ("size", bytes_text(path.stat().st_size))]
    if is_splat_ply(path):
        return [("kind", "Gaussian splats"), *rows]
    if len(xyz):
        mean = rgb.mean(axis=0)
        rows.append(("bounds", f"{vector_text(xyz.min(axis=0))} to {vector_text(xyz.max(axis=0))}, in world units"))
        rows.append(("mean colour", f"red {mean[0]:.0f}, green {mean[1]:.0f}, blue {mean[2]:.0f} of 255"))
    return rows


def _checkpoint(path: Path) -> Rows:
    """Describe a checkpoint from the header of its file.

    The tensors are not read, because tensors may be large and importing torch is slow.
    """
    damaged = UserError(f"{path}: expected a whole safetensors file, got a damaged file; name another checkpoint")
    size = path.stat().st_size
    with open_regular(path) as stream:
        length = int.from_bytes(stream.read(8), "little")
        if size < 8 or length > min(size - 8, _MOST_HEADER):
            raise damaged
        header = _parsed(stream.read(length), json.loads, damaged)
    notes = header.pop("__metadata__", {})
    try:
        counts = [int(np.prod(entry["shape"], dtype=np.int64)) for entry in header.values()]
        end = max((int(entry["data_offsets"][1]) for entry in header.values()), default=0)
    except (TypeError, KeyError, IndexError, ValueError, OverflowError) as error:
        raise damaged from error
    if 8 + length + end != size:
        raise damaged
    rows = [("size", bytes_text(size)), ("tensors", f"{len(counts)}, {sum(counts):,} numbers")]
    if isinstance(notes, dict):
        rows += [(key, str(notes[key])) for key in ("format", "step") if key in notes]
    return rows


def _video(path: Path, parser: ParserProcess) -> Rows:
    """Describe a video in a child process, because a damaged video can crash FFmpeg."""
    require_regular(path)
    rows = parser.call("fourd.cli.scenes.description.video:describe_video", path).value
    return [(str(name), str(value)) for name, value in rows]


def _run(path: Path) -> Rows:
    bad = UserError(f"{path / 'config.yaml'}: expected the config.yaml of a run, got other content; restore the file")
    try:
        # The YAML nodes are not converted to Python objects, because a small file with aliases can describe huge
        # objects.
        config = yaml.compose(read_limited(path / "config.yaml", MAX_CONFIG_BYTES), Loader=yaml.SafeLoader)
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise bad from error
    if not isinstance(config, yaml.MappingNode):
        raise bad
    train = _entry(config, "train")
    steps = [int(file.stem) for file in checkpoint_files(path / CHECKPOINTS)]
    segments = segment_folders(path)
    rows = [
        ("capture", _text(_entry(config, "capture")) or "unknown"),
        ("checkpoints", ", ".join(f"step {step:,}" for step in steps) or "none yet"),
        ("held out", _text(_entry(train, "test_views")) or "no views"),
        ("frames", _text(_entry(train, "frames")) or "all"),
    ]
    if segments:
        trained = sum(1 for segment in segments if checkpoint_files(segment / CHECKPOINTS))
        rows[1] = ("segments", f"{len(segments)}, of which {trained} have a checkpoint")
    rows += [("quality", line) for line in quality_lines(path)]
    rows += [("last measured", line) for line in last_metrics(path / "metrics.jsonl")]
    rows.append(("first points", f"{sum(1 for _ in path.glob('hull/*.ply'))} frames"))
    rows.append(("size", bytes_text(folder_bytes(path))))
    return rows


def _entry(node: yaml.Node | None, key: str) -> yaml.Node | None:
    """Return the value of a key in a YAML mapping, or None if there is no such key."""
    entries = node.value if isinstance(node, yaml.MappingNode) else []
    return next((value for name, value in entries if isinstance(name.value, str) and name.value == key), None)


def _text(node: yaml.Node | None) -> str:
    """Return the text of a YAML scalar, or of a list of scalars. The text is empty for null and for all other nodes."""
    if isinstance(node, yaml.SequenceNode):
        return names_text(_text(item) for item in node.value if isinstance(item, yaml.ScalarNode))
    if not isinstance(node, yaml.ScalarNode) or node.value in ("null", "~"):
        return ""
    return node.value if len(node.value) <= _MOST_TEXT else f"{node.value[:_MOST_TEXT]}..."


def _capture(path: Path) -> Rows:
    calibrated = (path / "intri.yml").is_file() and (path / "extri.yml").is_file()
    folders = _cameras_in(path / "images")
    videos = sort_names(file.name for file in path.glob("videos/*") if file.suffix.lower() in VIDEO_SUFFIXES)
    rows: Rows = []
    if calibrated and (folders or videos):
        from fourd.recording.capture import open_capture

        with open_capture(path, partial_mattes=True) as capture:
            rows.append(("cameras", f"{len(capture.names)}, calibrated: {names_text(capture.names)}"))
            rate = f" at {format_rate(capture.fps)} per second" if capture.fps else f", {UNKNOWN_RATE}"
            rows.append(("frames", f"{capture.frame_count}{rate}; {numbers_text(capture.frame_numbers)}"))
            rows.append(("image sizes", sizes_text((camera.width, camera.height) for camera in capture.cameras)))
            rows.append(("world unit", unit_text(capture.metres_per_unit)))
            rows += split_and_masks(path, capture)
    else:
        rows.append(("cameras", f"{len(folders)} in images/: {names_text(folders)}" if folders else "none in images/"))
        rows.append(("calibration", "yes" if calibrated else "none: training needs intri.yml and extri.yml"))
    rows.append(("videos", names_text(videos) or "none"))
    has_plates = (path / "bgs").is_dir() or (path / ".fourd" / "plates").is_dir()
    return [*rows, ("background plates", "yes" if has_plates else "none")]


def _cameras_in(images: Path) -> list[str]:
    return [
        name
        for name in camera_folders(images)
        if any(Path(file).suffix.lower() in PICTURE_SUFFIXES for file in list_folder(images / name))
    ]


def _parsed(text: bytes, parse: Callable[[bytes], Any], damaged: UserError) -> dict[str, Any]:
    try:
        content = parse(text)
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise damaged from error
    if not isinstance(content, dict):
        raise damaged
    return content
