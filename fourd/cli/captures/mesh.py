"""Make one textured triangle mesh for each frame of a capture, and an animation of all frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fourd.base.errors import UserError
from fourd.base.processes import locked_folder
from fourd.base.progress import Terminal
from fourd.cli.options import (
    FRAMES_HELP,
    VIEWS_HELP,
    HullAgreement,
    HullLeastViews,
    check_hull_shares,
    option,
    split_names,
)
from fourd.cli.outputs import READS, WRITES
from fourd.reconstruction.meshes.fitting.settings import FitSettings
from fourd.reconstruction.meshes.settings import MeshFormat, MeshSettings
from fourd.reconstruction.training.run_layout import CONFIG_NAME

if TYPE_CHECKING:
    from fourd.reconstruction.training.cameras.selection import DataSelection


@dataclass(frozen=True)
class Arguments:
    """The command writes FRAME.glb for each frame and animation.glb. The mesh of a frame starts as the visual hull of
    the mattes, and is fitted to mattes and images. Run an interrupted command again to resume it.
    """

    source: tyro.conf.Positional[Annotated[Path, READS, tyro.conf.arg(metavar="CAPTURE|RUN")]]
    """A run folder, or a capture folder with masks/ or the output of fourd matte. For a run folder, the meshes are made
    from the run's capture, with the views, frames and refined cameras of the run."""
    out: Annotated[Path, WRITES, tyro.conf.arg(aliases=["-o"], metavar="DIR")]
    """Folder to write the meshes to."""
    views: Annotated[str | None, option("NAME,NAME", "all", VIEWS_HELP)] = None
    frames: Annotated[str | None, option("A:B[:S]", "all", FRAMES_HELP)] = None
    test_views: Annotated[str | None, option("NAME,NAME", "none, or the held-out views of the run")] = None
    """Names of held-out cameras, separated by commas. The meshes are made without these cameras and compared with their
    images. The scores are written to scores.json."""
    scale: Annotated[float | None, option("FLOAT", "1, or the scale of the run")] = None
    """Scale factor of the images. A factor of 0.5 halves width and height."""
    cells: int = MeshSettings.cells
    """Number of grid cells along the longest side of the subject. The number of triangles grows with the square of this
    number, and the computing time grows at least as fast."""
    steps: int = FitSettings.steps
    """Number of gradient-descent steps per frame. If it is 0, the meshes are the visual hulls."""
    remesh: float = MeshSettings.remesh
    """Remesh to nearly equilateral triangles with this edge length, in grid cells. 0 keeps the triangles of the grid.
    Remeshing needs the package gpytoolbox (pip install 'fourd[mesh]')."""
    texture_size: int = MeshSettings.texture_size
    """Width and height of the textures in texels."""
    format: MeshFormat = MeshSettings.format
    """glb: textured meshes with the y axis up. ply: meshes with one colour per vertex, in world coordinates."""
    agreement: HullAgreement = MeshSettings.agreement
    least_views: HullLeastViews = MeshSettings.least_views
    seed: int = 0
    """Random seed of the order in which the views are fitted."""
    force: bool = False
    """Replace the meshes in DIR if they were made from other files or with other settings."""


def run(arguments: Arguments) -> None:
    """Make the meshes and print the scores of held-out views."""
    from rich.table import Table

    from fourd.pipeline.runner import Runner
    from fourd.pipeline.stage import Context
    from fourd.pipeline.stages.mesh import MeshFiles, MeshStageSettings, mesh_stage, read_scores

    settings = _settings(arguments)
    capture, selection, adjusted = _source(arguments)
    console = Terminal(stderr=True)
    files = MeshFiles(capture, arguments.out, adjusted)
    with locked_folder(arguments.out):
        Runner(Context(console)).run([mesh_stage(files, MeshStageSettings(selection, settings, arguments.force))])
    written = sorted(path.name for path in arguments.out.glob(f"*.{settings.format}"))
    console.print(f"{arguments.out}: {', '.join(written[:2])} ... {len(written)} files", soft_wrap=True, markup=False)
    scores = read_scores(arguments.out) if selection.test_views and settings.format == "glb" else None
    if scores is not None:
        table = Table(title=f"{arguments.out}: held-out views {', '.join(selection.test_views)}")
        for column in ("silhouette IoU", "PSNR dB inside the matte's box"):
            table.add_column(column, justify="right")
        table.add_row(f"{scores.iou:.4f}", "not measured" if scores.psnr is None else f"{scores.psnr:.2f}")
        Terminal().print(table)


def _settings(arguments: Arguments) -> MeshSettings:
    from fourd.reconstruction.meshes.settings import MAX_TEXTURE_SIZE
    from fourd.reconstruction.meshes.surface.remeshing import remeshing_is_available

    for name, least in (("cells", 8), ("steps", 0), ("texture_size", 16)):
        value = getattr(arguments, name)
        if value < least:
            raise UserError(f"--{name.replace('_', '-')}: expected at least {least}, got {value}")
    if arguments.texture_size > MAX_TEXTURE_SIZE:
        raise UserError(f"--texture-size: expected at most {MAX_TEXTURE_SIZE} texels, got {arguments.texture_size}")
    if not 0 <= arguments.remesh < float("inf"):
        raise UserError(f"--remesh: expected 0 or more cells, got {arguments.remesh:g}")
    if arguments.remesh > 0 and not remeshing_is_available():
        raise UserError("--remesh: expected the package gpytoolbox, got none; pip install 'fourd[mesh]'")
    check_hull_shares(arguments.agreement, arguments.least_views)
    return MeshSettings(
        cells=arguments.cells,
        texture_size=arguments.texture_size,
        format=arguments.format,
        remesh=arguments.remesh,
        agreement=arguments.agreement,
        least_views=arguments.least_views,
        fit=FitSettings(steps=arguments.steps, seed=arguments.seed),
    )


def _source(arguments: Arguments) -> tuple[Path, DataSelection, Path | None]:
    """Return the capture folder, the selected views and frames, and the run whose refined cameras replace the capture's
    cameras, or None."""
    from fourd.reconstruction.training.cameras.selection import DataSelection
    from fourd.reconstruction.training.run import open_run

    source, chosen = arguments.source, DataSelection()
    capture, run_folder = source, None
    if (source / CONFIG_NAME).is_file():
        opened = open_run(source)
        capture, chosen = opened.config.capture, DataSelection.of(opened.config.train)
        refine = opened.config.train.refine
        run_folder = source if refine.cameras or refine.colours else None
    views, test_views = split_names(arguments.views), split_names(arguments.test_views)
    return (
        capture,
        DataSelection(
            chosen.views if views is None else views,
            chosen.test_views if test_views is None else test_views,
            chosen.frames if arguments.frames is None else arguments.frames,
            chosen.image_scale if arguments.scale is None else arguments.scale,
        ),
        run_folder,
    )
