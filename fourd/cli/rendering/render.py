"""Render a run, a scene or meshes from cameras or along a camera path, as PNG files or a video."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.progress import Terminal
from fourd.base.storage import Location
from fourd.cli.help import RARE
from fourd.cli.locations import PATH_OR_URL, scene_or_copy
from fourd.cli.options import Frames, StyleName, check_rendering, option, split_names
from fourd.cli.outputs import READS, WRITES, require_distinct
from fourd.cli.rendering.camera_options import read_cameras
from fourd.cli.rendering.lens_options import LensOptions
from fourd.cli.rendering.opening import open_source, through_lens
from fourd.cli.rendering.output_options import OutputOptions, OutputWriter, check_outputs
from fourd.cli.rendering.path_options import PathOptions, check_path_options, make_plan, path_scene
from fourd.cli.rendering.sound import video_sound
from fourd.cli.rendering.stereo_options import Eyes, StereoOptions, make_eyes
from fourd.cli.scenes.description.values import count_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from fourd.base.cameras import Camera
    from fourd.scene.playable import Playable
    from fourd.viewer.output.sound import VideoSound


@dataclass(frozen=True)
class Arguments:
    """Writes the images OUT/CAM/FRAME.png with --views, and OUT/STEP.png with --path. If OUT ends in .mp4, .webm or
    .gif, the command writes a video instead of images. If OUT ends in .json, it writes the path itself."""

    source: tyro.conf.Positional[Annotated[Location, READS, PATH_OR_URL, tyro.conf.arg(metavar="RUN|SCENE|MESH")]]
    """Run folder, .4dv file or its URL, mesh (.glb or .ply), or folder with a mesh for each frame."""
    out: Annotated[Path, WRITES, tyro.conf.arg(aliases=["-o"])]
    """Folder for PNG files, or a video: an .mp4 (H.264), .webm (VP9) or .gif file. Or the path as a camera path of
    nerfstudio (.json), with the poses of a data set (transforms.json), or of fourd (.path.json)."""
    views: Annotated[str | None, option("NAME,NAME", "none; --views, --path or --cameras is required")] = None
    """Names of the capture cameras to render from, separated by commas. The cameras of meshes are named "side 1" to
    "side 8"."""
    path: Annotated[str | None, option("{orbit,spiral,cameras,FILE.json}", "none; --views or --path is required")] = (
        None
    )
    """orbit: one orbit around the scene. spiral: two orbits with changing height. cameras: a path through all capture
    cameras. FILE.json: a path of the window of fourd view, of the page, of nerfstudio's viewer, or transforms.json."""
    cameras: Annotated[str | None, RARE, option("FOLDER|INTRI,EXTRI", "the capture's cameras")] = None
    """Cameras of another calibration, in the world of the capture, instead of the capture's cameras: the files
    intri.yml and extri.yml, or their folder. Without --views, images of all these cameras are rendered."""
    frames: Frames = None
    steps: Annotated[int | None, option("INT", "those of the path file; 120, or the number of frames if larger")] = None
    """Number of images along the path. If the path has no times, the scene advances by one frame per image and plays in
    a loop."""
    playing: PathOptions = field(default_factory=PathOptions)
    size: Annotated[tuple[int, int] | None, option("W H", "the size of the path file's or the capture's images")] = None
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
    stereo_pairs: StereoOptions = field(default_factory=StereoOptions)
    passes: OutputOptions = field(default_factory=OutputOptions)
    fps: Annotated[float | None, option("FLOAT", "the path file's or the scene's")] = None
    """Frames per second of the video. If --frames selects every S-th frame, the default rate is divided by S."""


@dataclass(frozen=True, eq=False)
class _Shot:
    """An image to be rendered: ``name`` in ``folder``, which is relative to the output."""

    folder: Path
    name: str
    camera: Camera
    frame: int


def run(arguments: Arguments) -> None:
    """Open the source, choose the cameras, render and write the images."""
    console = Terminal(stderr=True)
    _check(arguments)
    with scene_or_copy(arguments.source) as source:
        written = _render(arguments, source, console)
    console.print(f"{arguments.out}: {written}", soft_wrap=True)


def _check(arguments: Arguments) -> None:
    """Raise UserError for options that are not valid, or not together, before anything is opened."""
    from fourd.viewer.output.video import is_video

    has_images = not _is_path_file(arguments.out)
    is_folder = has_images and not is_video(arguments.out)  # An invalid name is reported before anything is rendered.
    if (arguments.views is not None and arguments.path is not None) or (
        arguments.views is arguments.path is arguments.cameras is None
    ):
        raise UserError("--views, --path: expected exactly one of them; write --views 05,11 or --path orbit")
    if arguments.transparent and not is_folder:
        raise UserError(f"--transparent: expected a folder of PNG files, got {arguments.out}; name a folder with --out")
    if not has_images:
        if arguments.path is None:
            raise UserError(f"{arguments.out}: expected --path for a path file, got none; add --path, or name a folder")
        require_distinct(arguments.out, [Path(arguments.path)])
    check_path_options(arguments.playing, arguments.path)
    if check_outputs(arguments.passes):
        if not is_folder:
            raise UserError(f"--outputs: expected a folder, got {arguments.out}; name a folder with --out")
        if arguments.optics.is_used or arguments.style or arguments.transparent or arguments.stereo_pairs.stereo:
            raise UserError("--outputs: expected no --lens, --style, --stereo and --transparent with it; remove them")
    if arguments.style is not None and (arguments.optics.is_used or arguments.stereo_pairs.stereo):
        name = "--lens" if arguments.optics.is_used else "--stereo"
        raise UserError(f"--style, {name}: expected one of them, got both; styles are not drawn through a lens")
    size, steps = arguments.size, arguments.steps
    check_rendering(arguments.layers, _background(arguments), size=size, steps=steps, fps=arguments.fps)


def _render(arguments: Arguments, source: Location, console: Console) -> str:
    """Render the images, and return what was written."""
    from fourd.scene.playable import select_frames, selected_rate
    from fourd.viewer.output.video import is_video, require_video

    keeps_paper = arguments.background is None and not arguments.transparent
    playable = open_source(source, arguments.style, keeps_paper=keeps_paper)
    frames = select_frames(playable, arguments.frames)
    eyes = make_eyes(arguments.stereo_pairs, playable, console)
    if not _is_path_file(arguments.out) and is_video(arguments.out):
        require_video(arguments.out, arguments.fps or selected_rate(playable, frames))
    views = playable.views
    if arguments.cameras is not None:
        views = read_cameras(arguments.cameras, arguments.size, views, console)
    if arguments.path is not None:
        shots, fps = _along_path(arguments, playable, views, frames, console)
        if not shots:
            return "written"
    else:
        shots, fps = _from_views(arguments, playable, views, frames), selected_rate(playable, frames)
    if arguments.passes.outputs is not None:
        return _write_outputs(
            arguments,
            OutputWriter(arguments.passes, source, playable, arguments.layers, arguments.background, console),
            shots,
            console,
        )
    seen = (playable,) * len(eyes.rights)
    if arguments.optics.is_used:
        seen = through_lens(arguments.optics, source, playable, frames, eyes.rights)
    pictures = (_picture(seen, eyes, shot, arguments) for shot in _track(shots, console))
    rate, sound = arguments.fps or fps, None
    if is_video(arguments.out) and arguments.out.suffix.lower() != ".gif":
        sound = video_sound(source, [shot.frame for shot in shots], rate, console)
    _write(arguments, shots, pictures, rate, sound)
    return count_text(len(shots), "image")


def _write(
    arguments: Arguments,
    shots: list[_Shot],
    pictures: Iterable[NDArray[np.uint8]],
    fps: float,
    sound: VideoSound | None,
) -> None:
    from fourd.viewer.output.png import write_png
    from fourd.viewer.output.video import is_video, write_video

    if is_video(arguments.out):
        write_video(arguments.out, pictures, fps, sound=sound)
        return
    for shot, picture in zip(shots, pictures, strict=True):
        write_png(arguments.out / shot.folder / f"{shot.name}.png", picture)


def _write_outputs(arguments: Arguments, writer: OutputWriter, shots: list[_Shot], console: Console) -> str:
    for shot in _track(shots, console):
        writer.write(arguments.out / shot.folder, shot.name, shot.camera, shot.frame)
    writer.describe(arguments.out)
    return f"{count_text(len(shots), 'image')} of {', '.join(check_outputs(arguments.passes))}"


def _from_views(arguments: Arguments, playable: Playable, views: dict[str, Camera], frames: list[int]) -> list[_Shot]:
    from fourd.scene.playable import find_view

    names = split_names(arguments.views) if arguments.views is not None else tuple(views)
    cameras = {name: _fit(find_view(views, name), arguments.size) for name in names or ()}
    numbers = playable.frame_numbers
    return [
        _Shot(Path(name), f"{numbers[frame]:06d}", camera, frame)
        for frame in frames
        for name, camera in cameras.items()
    ]


def _along_path(
    arguments: Arguments, playable: Playable, views: dict[str, Camera], frames: list[int], console: Console
) -> tuple[list[_Shot], float]:
    """Return the images along the path, and the images per second. If the output is a path file, this file is written,
    and there are no images."""
    from fourd.scene.playable import selected_rate
    from fourd.viewer.camera_paths.reading import write_path

    assert arguments.path is not None
    scene = path_scene(playable, views)
    chosen = None if arguments.frames is None else frames
    plan, world = make_plan(arguments.path, arguments.playing, playable, scene, arguments.steps, chosen, arguments.size)
    for note in plan.path.notes:
        console.print(f"{arguments.path}: {note}", soft_wrap=True)
    if plan.path.lens not in ("pinhole", arguments.optics.lens) and not _is_path_file(arguments.out):
        raise UserError(
            f"{arguments.path}: expected --lens {plan.path.lens}, for which the path was made, got "
            f"{arguments.optics.lens or 'none'}; add it"
        )
    fps = plan.fps or selected_rate(playable, frames)
    if _is_path_file(arguments.out):
        first = plan.cameras[0]
        write_path(arguments.out, plan.path, (first.width, first.height), scene, world)
        return [], fps
    pairs = zip(plan.cameras, plan.frames, strict=True)
    return [_Shot(Path(), f"{step:06d}", camera, frame) for step, (camera, frame) in enumerate(pairs)], fps


def _is_path_file(out: Path) -> bool:
    return out.suffix.lower() == ".json" and not out.is_dir()


def _track(shots: list[_Shot], console: Console) -> Iterator[_Shot]:
    from rich.progress import track

    yield from track(shots, description="render", console=console)


def _background(arguments: Arguments) -> tuple[float, float, float]:
    from fourd.viewer.display import DEFAULT_BACKGROUND

    return arguments.background or DEFAULT_BACKGROUND


def _picture(seen: tuple[Playable, ...], eyes: Eyes, shot: _Shot, arguments: Arguments) -> NDArray[np.uint8]:
    """Return the image of a view, or the images of both eyes as one. A panorama has its eyes in its rays."""
    is_panorama = arguments.optics.lens == "panorama"
    pairs = zip(seen, eyes.rights, strict=True)
    cameras = [(each, shot.camera if is_panorama else eyes.camera(shot.camera, right)) for each, right in pairs]
    return eyes.join([_rgb(each, camera, shot.frame, arguments) for each, camera in cameras])


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
