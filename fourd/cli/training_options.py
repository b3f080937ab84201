"""Training options of ``fourd make`` and ``fourd train``, and how they override the training config."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.text import Text

from fourd.base.configs import assigned_keys, load_overlay, set_values
from fourd.base.errors import UserError
from fourd.base.progress import Terminal
from fourd.base.storage import local_path
from fourd.cli.help import RARE
from fourd.cli.options import (
    FRAMES_HELP,
    VIEWS_HELP,
    ExcludedViews,
    LpipsWeights,
    chosen_views,
    describe,
    option,
    split_names,
)
from fourd.cli.outputs import READS
from fourd.reconstruction.training.config import TrainConfig
from fourd.rendering.ops.device_name import DeviceName

if TYPE_CHECKING:
    from fourd.pipeline.report.summary import RunSummary

SEEDING_METHODS = ("ngp", "sfm")
"""Methods that compute the initial background points. ``--background`` accepts one of them or a PLY file."""
BACKGROUND_HELP = (
    "Source of the background points. Used only with --scene full. ngp: a radiance field fitted to the clean "
    "plates, guided by stereo depth maps. sfm: stereo depth maps only. FILE.ply: your own points, in world units."
)
TEST_VIEWS_DEFAULT = "the capture's test split, split.json, or none"
TEST_VIEWS_HELP = (
    "Names of held-out cameras, separated by commas, or none to train on all cameras. Held-out cameras are not used "
    "for carving or training."
)
SEGMENT_HELP = (
    "Maximum number of frames of one model. A longer capture is divided into segments. Each segment has its own model "
    "and the whole training budget. Successive segments share 4 frames, in which the scene fades from one segment to "
    "the next. Only for --scene object."
)
DEVICE_HELP = (
    "Device that trains. cuda: an NVIDIA GPU.",
    "auto: a GPU if torch and the kernels of fourd can use one, otherwise the CPU.",
    "The stages before and after training use the CPU.",
)
CONFIG_KEYS = {
    "scene": "scene",
    "test_views": "test_views",
    "views": "views",
    "frames": "frames",
    "scale": "image_scale",
    "points": "points",
    "background": "background.seeding",
    "background_points": "background.points",
    "max_seconds": "max_seconds",
    "max_steps": "max_steps",
    "seed": "seed",
    "segment": "segments.frames",
}
"""Maps fields of :class:`TrainingOptions` to dotted keys of the training config. If an option is given, its value
overrides the value of the key."""

SWITCHES = {
    "refine.poses": ("refine_cameras", True),
    "refine.focal": ("refine_cameras", True),
    "refine.colours": ("refine_colours", True),
    "segments.warm_start": ("warm_start", True),
    "held_out.on": ("no_held_out", False),
}
"""Maps dotted keys of the training config to fields of :class:`TrainingOptions`, and to the value of the key if the
flag of the field is given."""


def _config_option(name: str, metavar: str, text: str | None = None) -> Any:
    """Make an option that overrides a key of the config. --help shows the default value of the key."""
    value = operator.attrgetter(CONFIG_KEYS[name])(TrainConfig())
    return option(metavar, {None: "all", (): "none"}.get(value, str(value)), text)


@dataclass(frozen=True)
class TrainingOptions:
    """Flags and --set override the config file. The config file overrides the defaults."""

    scene: Annotated[Literal["object", "full"] | None, _config_option("scene", "{object,full}")] = None
    """object: reconstruct only the foreground that the mattes cover, and render it in front of black. full: also
    reconstruct a static background. With full, a capture needs no mattes if nothing moves in it or if it has only one
    frame."""
    config: Annotated[Path | None, RARE, READS, option("FILE.yaml", "none")] = None
    """YAML file with config keys. docs/configuration.md lists all keys."""
    assignments: Annotated[
        tuple[str, ...],
        RARE,
        tyro.conf.arg(name="set", metavar="KEY=VALUE", help_behavior_hint="(repeatable)"),
        tyro.conf.UseAppendAction,
    ] = ()
    """Set any config key, for example --set rates.planes=1e-3 --set model.planes.levels=3."""
    test_views: Annotated[str | None, option("NAME,NAME|none", TEST_VIEWS_DEFAULT, TEST_VIEWS_HELP)] = None
    no_held_out: Annotated[bool, RARE] = False
    """Without test views, train on all cameras from the start. By default, one camera is held out from the first part
    of training, to measure the quality of new views."""
    views: Annotated[str | None, RARE, _config_option("views", "NAME,NAME", VIEWS_HELP)] = None
    exclude_views: Annotated[ExcludedViews, RARE] = None
    frames: Annotated[str | None, _config_option("frames", "A:B[:S]", FRAMES_HELP)] = None
    scale: Annotated[float | None, _config_option("scale", "FLOAT")] = None
    """Scale factor of the images. A factor of 0.5 halves width and height."""
    points: Annotated[int | None, _config_option("points", "INT")] = None
    """Maximum number of points per frame."""
    background: Annotated[str | None, RARE, _config_option("background", "{ngp,sfm,FILE.ply}", BACKGROUND_HELP)] = None
    background_points: Annotated[int | None, RARE, _config_option("background_points", "INT")] = None
    """Maximum number of background points. Used only with --scene full."""
    refine_cameras: Annotated[bool, RARE] = False
    """Refine poses and focal lengths by bundle adjustment before carving, then by gradient descent during training."""
    refine_colours: Annotated[bool, RARE] = False
    """Correct the colours of each camera. The default is to do so if matching points show that the cameras differ."""
    keep_colours: Annotated[bool, RARE] = False
    """Do not correct the colours of the cameras, even if they differ."""
    segment: Annotated[int | None, RARE, _config_option("segment", "INT", SEGMENT_HELP)] = None
    warm_start: Annotated[bool, RARE] = False
    """With --segment: start the networks of each segment from the trained networks of the previous segment."""
    points_from: Annotated[Path | None, RARE, READS, option("DIR", "points are carved from the mattes")] = None
    """Folder with your own initial points in world units, as one PLY file per frame: 000000.ply and so on."""
    accept_mattes: Annotated[bool, RARE] = False
    """Train even if the visual hull covers less than a third of the area of the mattes."""
    max_seconds: Annotated[float | None, option("SECONDS", "1800 for fourd make without --max-steps, else none")] = None
    """Stop after this many seconds of training. fourd train needs --max-steps or --max-seconds."""
    max_steps: Annotated[int | None, option("INT", "none")] = None
    """Stop after this many training steps. fourd train needs --max-steps or --max-seconds."""
    device: Annotated[DeviceName, describe(*DEVICE_HELP)] = "auto"
    seed: Annotated[int | None, RARE, _config_option("seed", "INT")] = None
    """Random seed."""
    lpips_weights: Annotated[LpipsWeights, RARE] = None

    def train_config(self, max_seconds: float | None = None) -> TrainConfig:
        """Return the default config with the values of the config file, --set and the flags. --set and the flags
        override the config file.

        Args:
            max_seconds: training budget in seconds, used if neither the options nor the config file set a budget. If
                ``max_seconds`` is None, a missing budget raises UserError.
        """
        config = self.overlay(TrainConfig())
        if config.max_steps is None and config.max_seconds is None:
            if max_seconds is None:
                raise UserError("--max-steps, --max-seconds: expected at least one of them, got neither; set a budget")
            config = replace(config, max_seconds=max_seconds)
        return config

    def overlay(self, config: TrainConfig) -> TrainConfig:
        """Return ``config`` with the values of the config file, --set and the flags."""
        if self.config is not None:
            config = load_overlay(config, self.config)
        assigned = assigned_keys(self.assignments)
        config = set_values(config, self.assignments)
        for name, key in CONFIG_KEYS.items():
            value = getattr(self, name)
            if value is None:
                continue
            if key in assigned:
                raise UserError(f"{_flag(name)}, --set {key}: expected one of them, got both; remove one")
            config = _replace_key(config, key, _config_values(name, key, value), _flag(name))
        for key, (name, value) in SWITCHES.items():
            if getattr(self, name):
                config = _replace_key(config, key, {key.rpartition(".")[2]: value}, _flag(name))
        if self.exclude_views is not None:
            if "views" in assigned:
                raise UserError("--exclude-views, --set views: expected one of them, got both; remove one")
            config = replace(config, views=chosen_views(self.views, self.exclude_views))
        if self.keep_colours:
            if self.refine_colours:
                raise UserError("--refine-colours, --keep-colours: expected one of them, got both; remove one")
            config = _replace_key(config, "refine.colours", {"colours": False}, "--keep-colours")
        if self.warm_start and config.segments.frames is None:
            raise UserError("--warm-start: expected also --segment, got only --warm-start; add --segment FRAMES")
        return config


def print_summary(summary: RunSummary, console: Console) -> None:
    """Print the quality of a run on the console, and the warnings on stderr."""
    for line in summary.lines:
        console.print(line, soft_wrap=True, highlight=False)
    if summary.decisions:
        console.print("decided:", soft_wrap=True)
    for line in summary.decisions:
        console.print(f"  {line}", soft_wrap=True, highlight=False, markup=False)
    for line in summary.warnings:
        Terminal(stderr=True).print(Text("warning: ", "yellow").append(line, "default"), soft_wrap=True)


def _flag(name: str) -> str:
    """Return the command-line option that sets the field ``name`` of :class:`TrainingOptions`."""
    return f"--{name.replace('_', '-')}"


def _config_values(name: str, key: str, value: Any) -> dict[str, Any]:
    """Return the config fields that the option ``name`` sets, and their new values."""
    if name == "background":
        return _seeding(value)
    if name in ("views", "test_views"):
        value = () if name == "test_views" and value.strip() == "none" else split_names(value)
    return {key.rpartition(".")[2]: value}


def _replace_key(config: Any, key: str, values: Mapping[str, Any], flag: str) -> Any:
    """Return a copy of ``config`` with new values in one of its nested dataclasses.

    Args:
        config: a dataclass.
        key: dotted key of a field, for example "rates.planes". Its part before the last dot selects the dataclass.
        values: new values of fields of this dataclass, keyed by field name.
        flag: the command-line option, for errors.
    """
    head, _, rest = key.partition(".")
    if rest:
        values = {head: _replace_key(getattr(config, head), rest, values, flag)}
    try:
        return replace(config, **values)
    except ValueError as error:
        field, _, message = str(error).partition(": ")
        raise UserError(f"{flag}: {message if field == key else error}; change the value") from error


def _seeding(background: str) -> dict[str, Any]:
    """Convert the value of ``--background`` to fields of the background config."""
    if background in SEEDING_METHODS:
        return {"seeding": background, "seeds": None}
    seeds = local_path(background, "read the points of the background")
    if background.lower().endswith(".ply") or seeds.is_file():
        return {"seeds": seeds}
    raise UserError(
        f"--background: expected {', '.join(SEEDING_METHODS)} or a PLY file, got '{background}'; see fourd train --help"
    )
