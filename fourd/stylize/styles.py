"""The settings of a style. Each class is one section of a style file (YAML)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fourd.ops.stylize.parameters import MAX_THICKNESS, Detail, LineFilter, Triple

ShadingKind = Literal["none", "toon", "xtoon", "gooch"]
LightFrame = Literal["camera", "world"]
Stop = tuple[float, float, float, float]
MAX_LIGHT = 1e6
"""Largest coordinate of a light direction."""


@dataclass(frozen=True)
class Light:
    """The light of the shading.

    Attributes:
        direction: the direction towards the light, of any length.
        frame: the axes of ``direction``. In the frame "camera", x points right, y down and z away from the camera, so
            that the light moves with the camera. The frame "world" has the axes of the scene.
    """

    direction: Triple = (-0.5, -0.7, -0.5)
    frame: LightFrame = "camera"

    def __post_init__(self) -> None:
        length = math.hypot(*self.direction)
        if not 0 < length < MAX_LIGHT:
            raise ValueError(f"direction: expected a direction of length above 0, got {list(self.direction)}")


@dataclass(frozen=True)
class Ramp:
    """The colours of toon and X-Toon shading.

    Attributes:
        stops: lists of four numbers in [0, 1]: the tone at which a colour begins, and the red, green and blue of the
            colour. The first stop has the tone 0.
        softness: range of tones, from 0 to 1, over which one colour changes to the next.
        map: path of a PNG that replaces ``stops``. Each column of the PNG belongs to a tone, and each row to a value of
            the detail (see :class:`DetailAxis`), starting with 0 in the first row. Toon shading has 1 row, X-Toon
            shading has 1 to 64 rows.
        gain: factor by which the colours are multiplied.
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
    """The second axis of X-Toon shading: a colour depends on the tone and on the detail, which this class defines.

    Attributes:
        by: the quantity that determines the detail. With "depth", the detail is 0 at ``near`` and 1 at ``far``. With
            "focus", the detail is 0 at the depth ``focus`` and 1 at the distance ``far - near`` from ``focus``. With
            "facing", the detail is N.V to the power ``power``: 0 at silhouettes. N.V is the cosine of the angle between
            the normal and the direction to the camera.
        near, far, focus: depths, in multiples of the distance from the camera to the centre of the scene.
        power: exponent of N.V.
        fade: share of ``fade_colour`` in the colours where the detail is 1, or at silhouettes if ``by`` is "facing". If
            the ramp has a ``map``, ``fade`` has no effect.
        fade_colour: colour that ``fade`` mixes into the colours.
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
    """The two colours of Gooch shading: surfaces that face away from the light have the cool colour, and surfaces that
    face the light have the warm colour."""

    cool: Triple = (0.1, 0.16, 0.5)
    warm: Triple = (0.62, 0.5, 0.2)

    def __post_init__(self) -> None:
        _check_unit("cool", *self.cool)
        _check_unit("warm", *self.warm)


@dataclass(frozen=True)
class Angle:
    """Darkening of surfaces at grazing angles.

    Attributes:
        threshold: surfaces darken where N.V, the cosine between the normal and the direction to the camera, is below
            this number. 0 disables the darkening.
        softness: half of the width of the transition, in units of N.V.
        strength: largest share of ``colour`` in the darkened surface colour.
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
    """The lines of a drawing: the outlines of surfaces, and the lines inside the outlines.

    Attributes:
        filter: none, sobel (nine taps) or cross (five taps).
        depth: relative jump of depth at which a line begins, above 0.
        normal: change, over the filter's taps, of the cosine between the normal at the tap and the normal at the pixel.
            A line begins where the change exceeds this number. Above 0.
        thickness: distance between the taps in pixels of a picture with 1080 rows, 0.25 to 8. The width of lines is
            about twice ``thickness``.
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
            Brighter regions have thinner lines. With 0, there is no hatching.
        spacing: distance between neighbouring lines, measured along a row of the picture, in pixels of a picture with
            1080 rows.
        levels: brightness below which the first layer of lines begins, and brightness below which the second layer
            begins.
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
    """A style. The settings of the sections can be combined freely.

    Attributes:
        shading: how a colour depends on the light.
        albedo: share of the captured colours in the surface colours, 0 to 1. The remaining share is white, or ``base``
            if the shading is none. Gooch shading has no remaining share: it adds ``albedo`` times the captured colour
            to the shade colour.
        base: if the shading is none, this colour has the share ``1 - albedo`` in the surface colours.
        paper: colour behind the scene, or None for the background colour of the picture.
        persistence: weight of the previous picture while the camera does not move, from 0 to 0.95. The weight applies
            to the depth, to the normals, and to lines that were fainter in the previous picture.
        hysteresis: share by which the thresholds of lines are reduced where the previous picture has a line.
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
