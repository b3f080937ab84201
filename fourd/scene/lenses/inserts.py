"""Inserts, which are mirrors and glass balls in a scene: where rays meet them, and the rays that leave them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_GAP = 1e-4
"""Distance between an insert (a mirror or a glass ball) and the origin of a ray that continues from it, as a fraction
of the insert's radius."""


@dataclass(frozen=True)
class Branch:
    """Rays that continue from an insert (a mirror or a glass ball) after other rays have met it. The origins and the
    directions have the shape (R, 3). Each continued ray adds its light, multiplied by ``share`` (R,), to the light of
    the ray that met the insert."""

    origins: Array
    directions: Array
    share: Array


@dataclass(frozen=True)
class MirrorFloor:
    """A round mirror that lies in a plane, such as a polished floor. A ray that meets the mirror gets the light r * A +
    (1 - r) * B, where r is the reflectivity, A is the reflected light, and B is the mirror's own colour.

    Attributes:
        centre: (3,) position in world units.
        normal: (3,) unit normal of the reflecting side. It points from the mirror towards the objects that the mirror
            reflects.
        radius: radius in world units, above 0.
        reflectivity: the number r, from 0 to 1.
        colour: the mirror's own RGB colour B, in [0, 1].
    """

    centre: Array
    normal: Array
    radius: float
    reflectivity: float = 0.6
    colour: tuple[float, float, float] = (0.12, 0.12, 0.13)

    def hits(self, origins: Array, directions: Array) -> Array:
        """Return the values t (R,) at which rays ``origin + t * direction`` meet the mirror from its reflecting side;
        infinity for rays that miss it."""
        away = directions @ self.normal
        height = (origins - self.centre) @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -height / away
        distance = np.linalg.norm(origins + np.where(np.isfinite(t), t, 0)[:, None] * directions - self.centre, axis=1)
        return np.where((away < 0) & (height > 0) & (distance <= self.radius), t, np.inf)

    def leave(self, points: Array, directions: Array) -> tuple[list[Branch], Array]:
        """Return the reflections of the rays that arrive at ``points``, and the light (R, 3) that the mirror's own
        colour adds."""
        reflected = directions - 2 * (directions @ self.normal)[:, None] * self.normal
        share = np.full(len(points), self.reflectivity)
        light = (1 - share)[:, None] * np.asarray(self.colour)
        return [Branch(points + _GAP * self.radius * self.normal, reflected, share)], light


@dataclass(frozen=True)
class GlassBall:
    """A ball of clear glass. Refraction follows Snell's law. The reflectance follows Schlick's approximation of
    Fresnel's equations.

    Attributes:
        centre: (3,) position in world units.
        radius: radius in world units, above 0.
        refractive_index: refractive index of the glass, above 1.
    """

    centre: Array
    radius: float
    refractive_index: float = 1.5

    def hits(self, origins: Array, directions: Array) -> Array:
        """Return the values t (R,) at which rays ``origin + t * direction`` from outside meet the ball; infinity for
        rays that miss it."""
        offset = origins - self.centre
        a, b = (directions**2).sum(1), (offset * directions).sum(1)
        discriminant = b * b - a * ((offset**2).sum(1) - self.radius**2)
        t = (-b - np.sqrt(np.maximum(discriminant, 0))) / a
        return np.where((discriminant > 0) & (t > 0), t, np.inf)

    def leave(self, points: Array, directions: Array) -> tuple[list[Branch], Array]:
        """Return the reflected rays, and the rays that were refracted when they entered and left the ball. Reflections
        inside the ball are not traced: their light is counted as refracted light."""
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        unit = directions / length
        normal = (points - self.centre) / self.radius
        cosine = np.clip(-(unit * normal).sum(1, keepdims=True), 0, 1)
        least = ((self.refractive_index - 1) / (self.refractive_index + 1)) ** 2
        reflectance = (least + (1 - least) * (1 - cosine) ** 5)[:, 0]
        reflected = unit + 2 * cosine * normal
        # Inside the ball, a ray makes the same angle with the surface where it enters and where it leaves, so there is
        # no total internal reflection.
        ratio = 1 / self.refractive_index
        inside = ratio * unit + (ratio * cosine - np.sqrt(1 - ratio**2 * (1 - cosine**2))) * normal
        chord = -2 * self.radius * (inside * normal).sum(1, keepdims=True)
        far = points + chord * inside
        far_normal = (far - self.centre) / self.radius
        far_cosine = (inside * far_normal).sum(1, keepdims=True)
        sine_square = self.refractive_index**2 * (1 - far_cosine**2)
        bend = np.sqrt(np.maximum(1 - sine_square, 0)) - self.refractive_index * far_cosine
        outside = self.refractive_index * inside + bend * far_normal
        gap = _GAP * self.radius
        branches = [
            Branch(points + gap * normal, reflected, reflectance),
            Branch(far + gap * far_normal, outside, 1 - reflectance),
        ]
        return branches, np.zeros((len(points), 3))


Insert = MirrorFloor | GlassBall
