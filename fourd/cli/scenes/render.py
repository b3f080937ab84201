"""Render a run, a scene or meshes from cameras or along a camera path, as PNG files or a video."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import tyro
from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.progress import Terminal
from fourd.base.storage import Location
from fourd.cli.locations import PATH_OR_URL, scene_or_copy
from fourd.cli.options import Frames, StyleName, check_rendering, option, split_names
from fourd.cli.outputs import READS, WRITES
from fourd.cli.scenes.description.values import count_text
from fourd.cli.scenes.lens_options import LensOptions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from fourd.base.cameras import Camera
    from fourd.scene.lenses.inserts import Insert
    from fourd.scene.playable import Playable


@dataclass(frozen=True)
class Arguments:
    """Writes the images OUT/CAM/FRAME.png with --views, and OUT/STEP.png with --path. If OUT ends in .mp4, .webm or
    .gif, the command writes a video instead of images."""

    source: tyro.conf.Positional[Annotated[Location, READS, PATH_OR_URL, tyro.conf.arg(metavar="RUN|SCENE|MESH")]]
    """Run folder, .4dv file or its URL, mesh (.glb or .ply), or folder with a mesh for each frame."""
    out: Annotated[Path, WRITES, tyro.conf.arg(aliases=["-o"])]
    """Folder for PNG files, or a video: an .mp4 (H.264), .webm (VP9) or .gif file."""
    views: Annotated[str | None, option("NAME,NAME", "none; --views or --path is required")] = None
    """Names of the capture cameras to render from, separated by commas. The cameras of meshes are named "side 1" to
    "side 8"."""
    path: Annotated[str | None, option("{orbit,spiral,cameras,FILE.json}", "none; --views or --path is required")] = (
        None
    )
    """orbit: one orbit around the scene. spiral: two orbits with changing height. cameras: a path through all capture
    cameras. FILE.json: a path that was recorded in the window of fourd view."""
    frames: Frames = None
    steps: Annotated[int | None, option("INT", "120, or the number of frames if that is larger")] = None
    """Number of images along the path. The scene advances by one frame per image and plays in a loop."""
    size: Annotated[tuple[int, int] | None, option("W H", "the size of the capture's images")] = None
    """Width and height of the images in pixels."""
    layers: Annotated[int | None, option("INT", "the source's")] = None
    """Number of points composited per pixel (K), 1 to 64."""
    background: Annotated[
        tuple[float, float, float] | None, option("R G B", "the paper of the style, or else dark grey")
    ] = None
    """Background colour: red, green and blue, 0 to 1 each. Captures with masks are trained on black, 0 0 0."""
    transparent: bool = False
    """Write PNG files with an alpha channel instead of a background."""
    style: StyleName = None
    optics: LensOptions = field(default_factory=LensOptions)
    fps: Annotated[float | None, option("FLOAT", "the scene's")] = None
    """Frames per second of the video. If --frames selects every S-th frame, the default rate is divided by S."""


def run(arguments: Arguments) -> None:
    """Open the source, choose the cameras, render and write the images."""
    from fourd.viewer.output.video import is_video

    console = Terminal(stderr=True)
    is_video(arguments.out)  # An invalid name is reported before anything is rendered.
    if (arguments.views is None) == (arguments.path is None):
        raise UserError("--views, --path: expected exactly one of them; write --views 05,11 or --path orbit")
    if arguments.transparent and is_video(arguments.out):
        raise UserError(f"--transparent: expected a folder of PNG files, got {arguments.out}; name a folder with --out")
    size, steps = arguments.size, arguments.steps
    check_rendering(arguments.layers, _background(arguments), size=size, steps=steps, fps=arguments.fps)
    with scene_or_copy(arguments.source) as source:
        written = _render(arguments, source, console)
    console.print(f"{arguments.out}: {count_text(written, 'image')}", soft_wrap=True)


def _render(arguments: Arguments, source: Location, console: Console) -> int:
    from fourd.scene.playable import select_frames, selected_rate
    from fourd.viewer.output.video import is_video, require_video

    playable = _open(arguments, source)
    frames = select_frames(playable, arguments.frames)
    if arguments.optics.is_used:
        playable = _through_lens(arguments, source, playable, frames)
    fps = arguments.fps or selected_rate(playable, frames)
    if is_video(arguments.out):
        require_video(arguments.out, fps)
    if arguments.views is not None:
        return _write_views(arguments, playable, frames, fps, console)
    return _write_path(arguments, playable, frames, fps, console)


def _open(arguments: Arguments, source: Location) -> Playable:
    from fourd.scene.meshes.playable import PlayableMeshes
    from fourd.scene.meshes.source import is_mesh
    from fourd.scene.playable import open_playable
    from fourd.scene.styles import load_style, without_paper
    from fourd.viewer.playback.sources import open_frame_source
    from fourd.viewer.rendering.drawn_playable import DrawnPlayable, StyleDrawer

    style = None if arguments.style is None else load_style(arguments.style)
    if style is not None and (arguments.background is not None or arguments.transparent):
        style = without_paper(style)
    if isinstance(source, Path) and is_mesh(source):
        return PlayableMeshes(source, style)
    playable = open_playable(source)
    if style is None:
        return playable
    return DrawnPlayable(playable, open_frame_source(source), StyleDrawer(style))


def _through_lens(arguments: Arguments, path: Location, playable: Playable, frames: list[int]) -> Playable:
    """Return the scene as seen through the lens that the arguments describe.

    The mirror floor and an automatically placed glass ball are positioned relative to the subject's points in two of
    the rendered frames: the first and the middle one.
    """

    import numpy as np

    from fourd.cli.scenes.lens_options import make_inserts, make_lens
    from fourd.scene.meshes.source import is_mesh
    from fourd.viewer.playback.sources import open_frame_source
    from fourd.viewer.rendering.drawn_playable import DrawnPlayable, LensDrawer

    if arguments.style is not None:
        raise UserError("--style, --lens: expected one of them, got both; styles are not drawn through a lens")
    if isinstance(path, Path) and is_mesh(path):
        raise UserError(f"{path}: expected a run or a .4dv scene for --lens, got meshes")
    source = open_frame_source(path)
    views = list(playable.views.values())
    inserts: tuple[Insert, ...] = ()
    if arguments.optics.mirror_floor or arguments.optics.glass_ball is not None:
        chosen = sorted({frames[0], frames[len(frames) // 2]})
        read = [source.read(frame) for frame in chosen]
        subject = np.concatenate([frame.xyz[: frame.dynamic_count] for frame in read])
        inserts = make_inserts(arguments.optics, views, subject)
    if not views:
        raise UserError(f"{path}: expected a scene with cameras for --lens, got none")
    lens = make_lens(arguments.optics, views[0], playable.focus)
    return DrawnPlayable(playable, source, LensDrawer(lens, inserts))


def _write_views(arguments: Arguments, playable: Playable, frames: list[int], fps: float, console: Console) -> int:
    from fourd.scene.playable import find_view
    from fourd.viewer.output.png import write_png
    from fourd.viewer.output.video import is_video, write_video

    assert arguments.views is not None
    names = split_names(arguments.views) or ()
    cameras = [_fit(find_view(playable, name), arguments.size) for name in names]
    jobs = [(name, camera, frame) for frame in frames for name, camera in zip(names, cameras, strict=True)]
    if is_video(arguments.out):
        pictures = (_rgb(playable, camera, frame, arguments) for _, camera, frame in _track(jobs, console))
        write_video(arguments.out, pictures, fps)
        return len(jobs)
    for name, camera, frame in _track(jobs, console):
        number = playable.frame_numbers[frame]
        write_png(arguments.out / name / f"{number:06d}.png", _rgb(playable, camera, frame, arguments))
    return len(jobs)


def _write_path(arguments: Arguments, playable: Playable, frames: list[int], fps: float, console: Console) -> int:
    from fourd.viewer.output.png import write_png
    from fourd.viewer.output.video import is_video, write_video

    views, path_fps = _along_path(arguments, playable, frames)
    jobs = [("", camera, frame) for camera, frame in views]
    pictures = (_rgb(playable, camera, frame, arguments) for _, camera, frame in _track(jobs, console))
    if is_video(arguments.out):
        write_video(arguments.out, pictures, arguments.fps or path_fps or fps)
    else:
        for step, picture in enumerate(pictures):
            write_png(arguments.out / f"{step:06d}.png", picture)
    return len(jobs)


def _along_path(
    arguments: Arguments, playable: Playable, frames: list[int]
) -> tuple[list[tuple[Camera, int]], float | None]:
    """Return the camera and the index of the frame of each image along the path, and the images per second if the path
    file states them."""
    from fourd.viewer.navigation.paths import PathKind, camera_path
    from fourd.viewer.navigation.recorded_path import read_path_option

    assert arguments.path is not None
    views = list(playable.views.values())
    kinds: dict[str, PathKind] = {kind: kind for kind in get_args(PathKind)}
    if arguments.path not in kinds:
        recorded = read_path_option(arguments.path)
        if arguments.steps is not None or arguments.frames is not None:
            raise UserError(f"--path {arguments.path}: expected no --steps and no --frames, because the file has them")
        width, height = arguments.size or ((views[0].width, views[0].height) if views else (1280, 720))
        last = len(playable.frame_numbers) - 1
        samples = recorded.samples
        return [(each.pose.camera(width, height), min(each.frame, last)) for each in samples], recorded.fps
    steps = arguments.steps or max(120, len(frames))
    cameras = camera_path(
        kinds[arguments.path],
        views,
        playable.focus,
        steps,
        size=arguments.size,
        is_whole=playable.is_whole,
        bounds=playable.bounds,
    )
    return [(camera, frames[step % len(frames)]) for step, camera in enumerate(cameras)], None


def _track(jobs: list[tuple[str, Camera, int]], console: Console) -> Iterator[tuple[str, Camera, int]]:
    from rich.progress import track

    yield from track(jobs, description="render", console=console)


def _background(arguments: Arguments) -> tuple[float, float, float]:
    from fourd.viewer.display import DEFAULT_BACKGROUND

    return arguments.background or DEFAULT_BACKGROUND


def _rgb(playable: Playable, camera: Camera, frame: int, arguments: Arguments) -> NDArray[np.uint8]:
    """Return an image (H, W, 3), or (H, W, 4) with --transparent."""
    import numpy as np

    from fourd.viewer.output.png import with_alpha

    if arguments.transparent:
        black, white = (playable.render(camera, frame, arguments.layers, np.full(3, x, np.float32)) for x in (0, 1))
        return with_alpha(black, white)
    rgb = playable.render(camera, frame, arguments.layers, np.asarray(_background(arguments), np.float32))
    return (rgb.clip(0, 1) * 255 + 0.5).astype(np.uint8)


def _fit(camera: Camera, size: tuple[int, int] | None) -> Camera:
    from fourd.viewer.navigation.paths import fit_camera

    return camera if size is None else fit_camera(camera, *size)
