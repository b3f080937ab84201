"""Bake a trained run into a .4dv scene that renders in real time without torch, or export the run for other
programs."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from fourd.base.errors import UserError, command_line
from fourd.base.files import require_suffix
from fourd.base.progress import Terminal, Tracker
from fourd.base.storage import local_output, local_path
from fourd.cli.help import RARE
from fourd.cli.locations import OutLocation, transfer_progress
from fourd.cli.options import SOUNDTRACK_HELP, TIER_HELP, Frames, MaxMbps, check_mbps, check_rendering, describe, option
from fourd.cli.outputs import READS
from fourd.scene.exporting.format import Format
from fourd.scene.files.encoding import Tier
from fourd.scene.scene import BAKED_LAYERS

if TYPE_CHECKING:
    from fourd.scene.rendering import Scene

SCRATCH = ".export"
"""Name of a temporary folder beside the output. With --to, a run is first baked into this folder, and the baked scene
is then exported."""


@dataclass(frozen=True)
class Arguments:
    """Without --to, the command bakes the newest checkpoint of a run into a .4dv file. With --to, the command writes
    files for other programs.
    """

    source: tyro.conf.Positional[Annotated[Path, READS, tyro.conf.arg(metavar="RUN|SCENE")]]
    """Run folder. With --to, a .4dv file or a file of Gaussian splats is also accepted."""
    out: OutLocation
    """The .4dv file to write, or its URL such as s3://bucket/scene.4dv. With --to, a folder, or a file if one frame is
    exported. With --to usd, a file such as walk.usda can also play several frames."""
    layers: int = BAKED_LAYERS
    """Number of points composited per pixel (K), 1 to 64."""
    fps: Annotated[float | None, option("FLOAT", "the recording's frame rate, or 30 if it is not known")] = None
    """Playback rate in frames per second."""
    tier: Annotated[
        Tier | None,
        describe("Write a compact file, like `fourd pack`.", *TIER_HELP),
        option("{full,stream,video,light}", "not packed"),
    ] = None
    max_mbps: MaxMbps = None
    sound: Annotated[str, RARE, option("auto|none|CAM|FILE", "auto", SOUNDTRACK_HELP)] = "auto"
    to: Annotated[
        Format | None,
        describe(
            "Write files for other programs, one for each frame, or one for all frames with 4dgs.",
            "ply-sequence: Gaussian splats as 3DGS PLY. splat, spz, glb, usd: Gaussian splats in these formats.",
            "4dgs: Gaussian splats of all frames in one file. ply: coloured points. spz, usd and 4dgs need",
            "`pip install 'fourd[splats]'`.",
        ),
        option("{ply-sequence,splat,spz,glb,usd,4dgs,ply}", "a .4dv file"),
    ] = None
    frames: Frames = None
    """With --to: frames to export, by their numbers in the capture."""
    degree: Annotated[int | None, option("INT", "2, or 1 with 4dgs")] = None
    """With --to: largest degree of the spherical harmonics, 0 to 3. The formats splat and ply support only degree 0.
    The coefficients in 4dgs are so coarse that higher degrees add more noise than they improve."""
    keep_axes: bool = False
    """With --to: keep the scene's coordinates. Otherwise, the scene is rotated to the up axis that other programs
    expect: +y for spz, glb, usd and 4dgs, and -y for the other formats of splats. The format ply always keeps the
    coordinates."""


def run(arguments: Arguments) -> None:
    """Bake every frame, or write the files for other programs."""
    check_rendering(arguments.layers, fps=arguments.fps)
    check_mbps(arguments.max_mbps)
    console = Terminal(stderr=True)
    if arguments.to is not None:
        _export(arguments, arguments.to, console)
        return
    if arguments.source.is_file():
        raise UserError(
            f"{arguments.source}: expected a run's folder, got a file; add --to FORMAT to export it for other "
            "programs, or run fourd pack to make it smaller"
        )
    if arguments.frames is not None or arguments.keep_axes:
        raise UserError("--frames, --keep-axes: expected also --to, got none; add --to FORMAT")
    require_suffix(arguments.out, (".4dv",), "a scene")
    with local_output(arguments.out, transfer_progress()) as out:
        _bake(arguments, out, console)
        size = out.stat().st_size / 1e6
    command = command_line("fourd", "view", arguments.out)
    console.print(f"{arguments.out}: {size:.1f} MB; next: {command}", soft_wrap=True)


def _bake(arguments: Arguments, out: Path, console: Console) -> None:
    from fourd.pipeline.runner import Runner
    from fourd.pipeline.stage import Context
    from fourd.pipeline.stages.bake import BakeFiles, BakeSettings, bake_stage
    from fourd.scene.packing.report import PackSettings

    packed = arguments.tier is not None or arguments.max_mbps is not None
    pack = PackSettings(arguments.tier or "full", arguments.max_mbps) if packed else None
    stage = bake_stage(
        BakeFiles(arguments.source, out), BakeSettings(arguments.layers, arguments.fps, pack, arguments.sound)
    )
    Runner(Context(console)).run([stage])


def _export(arguments: Arguments, kind: Format, console: Console) -> None:
    from fourd.reconstruction.training.points.scratch import Scratch
    from fourd.scene.rendering import open_scene

    if arguments.tier is not None or arguments.max_mbps is not None:
        raise UserError("--to: expected no --tier and no --max-mbps, got at least one; they are for .4dv files")
    if not 0 <= (arguments.degree or 0) <= 3:
        raise UserError(f"--degree: expected 0 to 3, got {arguments.degree}")
    out = local_path(arguments.out, "export files for other programs")
    if not arguments.source.is_dir() or not (arguments.source / "config.yaml").exists():
        with open_scene(arguments.source) as scene:
            _write(arguments, out, kind, scene, console)
        return
    # If this process is killed, the next command removes the folder.
    with closing(Scratch(out.parent / SCRATCH)) as scratch:
        baked = scratch.folder / "scene.4dv"
        _bake(arguments, baked, console)
        with open_scene(baked) as scene:
            _write(arguments, out, kind, scene, console)


def _write(arguments: Arguments, out: Path, kind: Format, scene: Scene, console: Console) -> None:
    from fourd.scene.exporting.export import ExportSettings, export_scene
    from fourd.scene.playable import PlayableScene, select_frames

    frames = select_frames(PlayableScene(scene), arguments.frames)
    degree = (1 if kind == "4dgs" else 2) if arguments.degree is None else arguments.degree
    settings = ExportSettings(kind, frames, degree, arguments.keep_axes)
    report = export_scene(scene, out, settings, Tracker(console).track)
    loss = "" if report.psnr is None else f"; PSNR of the colours against the scene: {report.psnr:.1f} dB"
    count = f"{len(frames)} frame{'s' if len(frames) > 1 else ''}"
    console.print(f"{out}: {count}, {report.bytes_per_frame / 1e6:.2f} MB each{loss}", soft_wrap=True, markup=False)
