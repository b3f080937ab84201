"""The settings of a style: one class for each section of a style file (YAML)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fourd.rendering.ops.stylize.parameters import MAX_THICKNESS, Detail, LineFilter, Triple

ShadingKind = Literal["none", "toon", "xtoon", "gooch"]
LightFrame = Literal["camera", "world"]
Stop = tuple[float, float, float, float]
MAX_LIGHT = 1e6
"""Upper bound on the length of a light direction."""


@dataclass(frozen=True)
class Light:
    """The light of the shading.

    Attributes:
        direction: the direction towards the light, of any length.
        frame: coordinate frame of ``direction``. In "camera", x points right, y down and z away from the camera, so the
            light moves with the camera. "world" has the axes of the scene.
    """

    direction: Triple = (-0.5, -0.7, -0.5)
    frame: LightFrame = "camera"

    def __post_init__(self) -> None:
        length = math.hypot(*self.direction)
        if not 0 < length < MAX_LIGHT:
            raise ValueError(f"direction: expected a direction of length above 0, got {list(self.direction)}")


@dataclass(frozen=True)
class Ramp:
    """The colours of toon and X-Toon shading, as a function of the tone. The tone is the brightness of the shading: (1
    + N.L) / 2 for the cosine N.L between the normal and the direction to the light.

    Attributes:
        stops: lists of four numbers in [0, 1]: the tone at which a colour begins, and its red, green and blue. The
            first stop has the tone 0.
        softness: width of the range of tones over which one colour changes to the next, from 0 to 1.
        map: path of a shade map, a PNG that replaces ``stops``. Its columns have the colours of the tones from 0 to 1,
            and its rows those of the details from 0 to 1 (see :class:`DetailAxis`). The PNG has 1 row for toon shading,
            and 1 to 64 rows for X-Toon shading.
        gain: factor for the colours.
    """

    stops: tuple[Stop, ...] = ((0.0, 0.42, 0.42, 0.52), (0.45, 0.72, 0.7, 0.74), (0.72, 1.0, 1.0, 1.0))
    softness: float = 0.03
    map: Path | None = None
    gain: float = 1.1

    def __post_init__(self) -> None:
        tones = [stop[0] for stop in self.stops]
        if not tones or tones[0] != 0 or tones != sorted(tones) or len(tones) > 32:
            raise ValueError(f"stops: expected 1 to 32 stops with rising tones, the first 0, got the tones {tones}")
        for stop in self.stops:
            _check_unit("stops", *stop)
        _check_unit("softness", self.softness)
        _check_range("gain", self.gain, 0, 10)


@dataclass(frozen=True)
class DetailAxis:
    """The detail, the second quantity in [0, 1] on which the colours of X-Toon shading depend. The first one is the
    tone (see :class:`Ramp`).

    Attributes:
        by: the quantity that determines the detail. For "depth", the detail is 0 at ``near`` and 1 at ``far``. For
            "focus", it is 0 at the depth ``focus`` and 1 at the distance ``far - near`` from it. For "facing", it is
            N.V to the power ``power``, where N.V is the cosine between the normal and the direction to the camera, so
            it is 0 at silhouettes.
        near, far, focus: depths, as multiples of the distance from the camera to the centre of the scene.
        power: exponent of N.V.
        fade: fraction of ``fade_colour`` that is mixed into the colours where the detail is 1, or at silhouettes if
            ``by`` is "facing". It has no effect if the ramp has a ``map``.
        fade_colour: the colour that is mixed in.
    """

    by: Detail = "facing"
    near: float = 0.7
    far: float = 1.6
    focus: float = 1.0
    power: float = 1.0
    fade: float = 0.0
    fade_colour: Triple = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if not self.far - self.near > 1e-6:
            raise ValueError(f"far: expected more than near ({self.near:g}), got {self.far:g}")
        for name in ("near", "far", "focus"):
            _check_range(name, getattr(self, name), 0, 1e6)
        _check_range("power", self.power, 0.01, 100)
        _check_unit("fade", self.fade)
        _check_unit("fade_colour", *self.fade_colour)


@dataclass(frozen=True)
class Gooch:
    """The two colours of Gooch shading: cool for surfaces that face away from the light, and warm for surfaces that
    face it."""

    cool: Triple = (0.1, 0.16, 0.5)
    warm: Triple = (0.62, 0.5, 0.2)

    def __post_init__(self) -> None:
        _check_unit("cool", *self.cool)
        _check_unit("warm", *self.warm)


@dataclass(frozen=True)
class Angle:
    """Darkening of surfaces at grazing angles.

    Attributes:
        threshold: surfaces darken where the cosine between the normal and the direction to the camera, N.V, is below
            this number. 0 disables the darkening.
        softness: half the width of the transition, in units of N.V.
        strength: maximum fraction of ``colour`` in the darkened surface colour.
        colour: red, green and blue.
    """

    threshold: float = 0.0
    softness: float = 0.06
    strength: float = 0.0
    colour: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _check_unit("threshold", self.threshold)
        _check_range("softness", self.softness, 1e-4, 1)
        _check_unit("strength", self.strength)
        _check_unit("colour", *self.colour)


@dataclass(frozen=True)
class LineSettings:
    """The lines of a drawing: outlines of surfaces, and lines inside them. A filter finds them by comparing the depths
    and the normals at its taps, which are the pixel and samples around it.

    Attributes:
        filter: none, sobel (nine taps) or cross (five taps).
        depth: threshold for changes of the inverse depth, as a fraction of the largest inverse depth at the taps,
            positive. With sobel, a line is drawn where the change across the pixel exceeds the threshold. With cross,
            a line is drawn where half the sum of the second differences along row and column exceeds the threshold.
        normal: threshold for the cosines between the pixel's normal and the normals at the taps, positive. With sobel,
            a line is drawn where the cosines on opposite sides of the pixel differ by more than this number. With
            cross, a line is drawn where the cosine at a tap is below 1 minus this number.
        thickness: distance between the taps in pixels of an image with 1080 rows, 0.25 to 8. Lines are about twice as
            wide.
        opacity: opacity of the strongest lines, 0 to 1.
        colour: red, green and blue.
    """

    filter: LineFilter = "sobel"
    depth: float = 0.02
    normal: float = 0.45
    thickness: float = 1.5
    opacity: float = 1.0
    colour: Triple = (0.05, 0.04, 0.06)

    def __post_init__(self) -> None:
        _check_range("depth", self.depth, 1e-6, 10)
        _check_range("normal", self.normal, 1e-6, 10)
        _check_range("thickness", self.thickness, 0.25, MAX_THICKNESS)
        _check_unit("opacity", self.opacity)
        _check_unit("colour", *self.colour)


@dataclass(frozen=True)
class Hatching:
    """Parallel lines in dark regions.

    Attributes:
        width: width of the hatching lines where the brightness is 0, as a fraction of ``spacing``, from 0 to 1.
            Brighter regions have thinner lines. A width of 0 disables the hatching.
        spacing: distance between neighbouring lines along an image row, in pixels of an image with 1080 rows.
        levels: brightness values below which the first and the second layer of lines are drawn.
        colour: red, green and blue of the ink.
    """

    width: float = 0.0
    spacing: float = 9.0
    levels: tuple[float, float] = (0.75, 0.45)
    colour: Triple = (0.05, 0.04, 0.06)

    def __post_init__(self) -> None:
        _check_unit("width", self.width)
        _check_range("spacing", self.spacing, 1, 1000)
        _check_unit("levels", *self.levels)
        _check_unit("colour", *self.colour)


@dataclass(frozen=True)
class Style:
    """A style: all settings of the non-photorealistic rendering of a scene. They can be combined freely.

    Attributes:
        shading: how colours depend on the light.
        albedo: fraction of the captured colours in the surface colours, 0 to 1. The rest is white, or ``base`` if
            ``shading`` is "none". Gooch shading instead adds ``albedo`` times the captured colour to the shade colour.
        base: colour that makes up the fraction ``1 - albedo`` of the surface colours if ``shading`` is "none".
        paper: colour behind the scene, or None for the image's background colour.
        persistence: weight of the previous image in a running average of inverse depths, normals and line strengths,
            from 0 to 0.95. These are averaged while the camera does not move, at pixels where the surface does not move
            either. A line that becomes weaker gets its new strength at once.
        hysteresis: fraction by which line thresholds are reduced where the previous image has a line.
    """

    shading: ShadingKind = "none"
    albedo: float = 1.0
    base: Triple = (1.0, 1.0, 1.0)
    light: Light = field(default_factory=Light)
    ramp: Ramp = field(default_factory=Ramp)
    detail: DetailAxis = field(default_factory=DetailAxis)
    gooch: Gooch = field(default_factory=Gooch)
    angle: Angle = field(default_factory=Angle)
    lines: LineSettings = field(default_factory=LineSettings)
    hatching: Hatching = field(default_factory=Hatching)
    paper: Triple | None = None
    persistence: float = 0.7
    hysteresis: float = 0.2

    def __post_init__(self) -> None:
        _check_unit("albedo", self.albedo)
        _check_unit("base", *self.base)
        if self.paper is not None:
            _check_unit("paper", *self.paper)
        _check_range("persistence", self.persistence, 0, 0.95)
        _check_range("hysteresis", self.hysteresis, 0, 0.95)


def _check_unit(name: str, *values: float) -> None:
    for value in values:
        _check_range(name, value, 0, 1)


def _check_range(name: str, value: float, least: float, most: float) -> None:
    # NaN is rejected too, because comparisons with NaN are false.
    if not least <= value <= most:
        raise ValueError(f"{name}: expected {least:g} to {most:g}, got {value:g}")
