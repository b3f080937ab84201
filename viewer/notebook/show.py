"""The function :func:`fourd.show`, which shows scenes and runs in notebooks."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from fourd.base.errors import UserError
from fourd.base.progress import Terminal
from fourd.base.storage import local_path
from fourd.scene.files.encoding import Tier
from fourd.scene.rendering import Scene
from fourd.viewer.notebook.served import serve

if TYPE_CHECKING:
    from fourd.reconstruction.training.run import Run, TrainedRun
    from fourd.reconstruction.training.segments.segmented_run import SegmentedRun
    from fourd.viewer.notebook.widget import SceneWidget

PACKAGES = ("anywidget", "ipywidgets", "traitlets")
"""Import names of the packages of the extra ``fourd[notebook]`` that the widget uses."""
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}")


def show(
    source: Path | str | Scene | Run | TrainedRun | SegmentedRun,
    *,
    height: int = 480,
    autoplay: bool = True,
    background: str | None = None,
    embed: bool = False,
    tier: Tier = "stream",
    quiet: bool = False,
) -> SceneWidget:
    """Show a scene or a run in a notebook. Needs the extra: ``pip install 'fourd[notebook]'``.

    A scene that `fourd web` wrote is read in place, in the ranges that the page needs. Any other scene is packed into a
    temporary file first, and a run is baked first, from its newest checkpoint.

    Args:
        source: a `.4dv` file, a run's folder, or an open scene or run.
        height: height of the player in CSS pixels. It is as wide as the cell.
        autoplay: whether the scene plays at once, except for users who ask their system for less motion.
        background: colour behind the points, such as "#203040", or None for a dark grey.
        embed: whether the scene becomes a part of the widget's state, at most 64 MB. It then also plays in saved
            notebooks and pages without a kernel. By default, the page asks the kernel for each part of the scene.
        tier: how a scene that is not packed yet is compressed; see ``fourd pack --help``.
        quiet: whether to print no progress.

    Returns the widget, which a notebook shows if it is the value of the cell. Its method ``close`` removes the
    temporary file.

    Raises:
        UserError: if a package of the extra is missing, or if ``source`` is not a valid scene or run.
        ValueError: if ``height`` or ``background`` is invalid.
    """
    if not 1 <= height <= 10000:
        raise ValueError(f"height: expected 1 to 10000 pixels, got {height}")
    if background is not None and not _COLOUR.fullmatch(background):
        raise ValueError(f"background: expected a colour such as #203040, got '{background}'")
    widget_class = _load_widget()
    served = serve(_path_of(source), tier, Terminal(stderr=True, quiet=quiet))
    try:
        return widget_class(served, height=height, autoplay=autoplay, background=background, embed=embed)
    except BaseException:
        served.close()
        raise


def _path_of(source: Path | str | Scene | Run | TrainedRun | SegmentedRun) -> Path:
    """Return the file or folder of a source. Raises UserError if it is at a URL."""
    if isinstance(source, Scene):
        path = local_path(source.path, "show a scene")
    elif isinstance(source, str | Path):
        path = local_path(source, "show a scene")
    else:
        from fourd.reconstruction.training.run import Run

        path = (source if isinstance(source, Run) else source.run).folder
    if not path.exists():
        raise UserError(f"{path}: expected a .4dv file or a run's folder, got nothing there; check the path")
    return path


def _load_widget() -> type[SceneWidget]:
    try:
        from fourd.viewer.notebook.widget import SceneWidget
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in PACKAGES:
            raise
        raise UserError(
            f"fourd.show: expected the package {error.name}, got none; pip install 'fourd[notebook]'"
        ) from error
    return SceneWidget
