"""The empty dome: flat wall panels around a sphere, a floor, a ceiling and lamps, and their rendering.

World units are metres, +z points up, and the floor is the plane z = 0. The wall is a convex polyhedron, so a ray that
starts inside leaves it through the first panel's plane that it meets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.synth import render
from fourd.recording.synth.render import average_samples, pixel_rays

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

CENTRE = np.array([0.0, 0.0, 1.3])
RADIUS = 2.77
"""Distance of each panel from CENTRE in metres."""
CEILING = 3.5
PANELS = 64
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
BAND_SAMPLES = 1 << 15
"""Approximate number of rays that are rendered at once. Their arrays fit into the processor's cache."""
SEAM = 0.007
"""Half the width of the dark seam between two panels in metres."""
LAMPS = 8
LAMP_HEIGHT = 0.26
LAMP_SIZE = (0.42, 0.05)
"""Half the length and half the height of a lamp in metres."""
LAMP_LIGHT = 1.8
"""Brightness of a lamp. Values above 1 saturate, also in cameras with a low gain."""
WALL_COLOUR = np.array([0.55, 0.57, 0.53])
FLOOR_COLOUR = np.array([0.34, 0.33, 0.30])
CEILING_COLOUR = np.array([0.17, 0.18, 0.18])


@dataclass(frozen=True, eq=False)
class Room:
    """Panels of the wall.

    Attributes:
        normals: (P, 3) unit normals, which point outwards.
        axes: (P, 2, 3) unit vectors in the panels: one horizontal, the other one upwards.
        shades: (P,) brightness factors.
        tints: (P, 3) colour factors.
        phases: (P, 4) random phases of the texture in radians.
        markers: (P, 3) position of a coloured marker in the panel's coordinates in metres, and its side length; a side
            length of 0 means that the panel has no marker.
        marker_colours: (P, 3) RGB colours of the markers.
        cables: (P,) whether a cable lies on the panel.
        door: index of the panel that is an opening to a dark room.
    """

    normals: Array
    axes: Array
    shades: Array
    tints: Array
    phases: Array
    markers: Array
    marker_colours: Array
    cables: NDArray[np.bool_]
    door: int

    def wall_distance(self, direction: Array) -> float:
        """Return the distance from CENTRE to the wall along the unit vector ``direction`` (3,)."""
        cosines = self.normals @ direction
        return float(np.min(RADIUS / cosines[cosines > 1e-6]))


@dataclass(frozen=True, eq=False)
class EmptyView:
    """The image of the empty room.

    Attributes:
        rgb: (H, W, 3) colours. Lamps are brighter than 1.
        depth: (H, W) camera depth at the pixel centres in metres.
        floor: (H, W) fraction of each pixel's rays that hit the floor.
    """

    rgb: Array
    depth: Array
    floor: Array


def make_room(rng: np.random.Generator) -> Room:
    """Create a room with random colours and details."""
    normals = spiral_directions(PANELS, -0.6, 0.97)
    across = np.cross([0.0, 0.0, 1.0], normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    positions = rng.uniform(-0.35, 0.35, (PANELS, 2))
    sides = np.where(rng.uniform(size=PANELS) < 0.35, rng.uniform(0.035, 0.06, PANELS), 0.0)
    return Room(
        normals=normals,
        axes=np.stack([across, np.cross(normals, across)], axis=1),
        shades=rng.uniform(0.93, 1.05, PANELS),
        tints=1 + rng.normal(0, 0.008, (PANELS, 3)),
        phases=rng.uniform(0, 2 * np.pi, (PANELS, 4)),
        markers=np.column_stack([positions, sides]),
        marker_colours=rng.uniform(0.05, 0.9, (PANELS, 3)),
        cables=rng.uniform(size=PANELS) < 0.1,
        door=int(np.argmin(np.linalg.norm(normals - [0.3, 0.93, -0.1], axis=1))),
    )


def spiral_directions(count: int, lowest: float, highest: float) -> Array:
    """Return unit vectors (count, 3) that are evenly spread on a sphere between two heights, in order of height."""
    heights = lowest + (highest - lowest) * (np.arange(count) + 0.5) / count
    angles, radii = GOLDEN_ANGLE * np.arange(count), np.sqrt(1 - heights**2)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles), heights])


def render_room(room: Room, camera: Camera) -> EmptyView:
    """Render the room as seen by a camera inside it."""
    bands = []
    rows = max(1, BAND_SAMPLES // (camera.width * render.SAMPLES**2))
    for top in range(0, camera.height, rows):
        bands.append(_render_band(room, camera, top, min(top + rows, camera.height)))
    return EmptyView(*(np.concatenate(values) for values in zip(*bands, strict=True)))


def _render_band(room: Room, camera: Camera, top: int, bottom: int) -> tuple[Array, Array, Array]:
    samples = render.SAMPLES
    u, v = pixel_rays(
        camera,
        (np.arange(camera.width * samples) + 0.5) / samples,
        top + (np.arange((bottom - top) * samples) + 0.5) / samples,
    )
    shape = (len(v), len(u))
    rays = np.stack([*np.meshgrid(u, v), np.ones(shape)], axis=-1).reshape(-1, 3) @ camera.rotation
    wall, panel = _leave_walls(room, camera.centre, rays)
    with np.errstate(divide="ignore"):
        floor = np.where(rays[:, 2] < 0, -camera.centre[2] / rays[:, 2], np.inf)
        ceiling = np.where(rays[:, 2] > 0, (CEILING - camera.centre[2]) / rays[:, 2], np.inf)
    depth = np.minimum(np.minimum(floor, ceiling), wall)
    xyz = camera.centre + depth[:, None] * rays
    colour = np.empty_like(xyz)
    for surface, shade in (((depth == floor), _floor_colours), ((depth == ceiling), _ceiling_colours)):
        colour[surface] = shade(xyz[surface])
    on_wall = (depth != floor) & (depth != ceiling)
    colour[on_wall] = _wall_colours(room, xyz[on_wall], panel[on_wall])
    centres = np.s_[samples // 2 :: samples, samples // 2 :: samples]
    return (
        average_samples(colour.reshape(*shape, 3)),
        depth.reshape(shape)[centres],
        average_samples((depth == floor).astype(np.float64).reshape(shape)),
    )


def _leave_walls(room: Room, eye: Array, rays: Array) -> tuple[Array, Indices]:
    """Return the parameter t (N,) at which each ray ``eye + t * ray`` leaves the walls, and the panel's index (N,)."""
    best, panel = np.full(len(rays), np.inf), np.zeros(len(rays), dtype=np.int64)
    for index, normal in enumerate(room.normals):
        cosine = rays @ normal
        with np.errstate(divide="ignore"):
            t = np.where(cosine > 0, (RADIUS - float((eye - CENTRE) @ normal)) / cosine, np.inf)
        closer = t < best
        np.copyto(best, t, where=closer)
        np.copyto(panel, index, where=closer)
    return best, panel


def _seam_distances(room: Room, xyz: Array, panel: Indices) -> Array:
    """Return the distances (N,) in metres from points on the walls to the edges of their panels."""
    distance = np.full(len(xyz), np.inf)
    cosines = room.normals @ room.normals.T
    for index in np.flatnonzero((cosines[np.unique(panel)] > 0.5).any(axis=0)):
        # Two panels that enclose an angle of 90 degrees have no common edge.
        near = np.flatnonzero((cosines[index, panel] > 0.5) & (panel != index))
        sine = np.sqrt(1 - cosines[index, panel[near]] ** 2)
        distance[near] = np.minimum(distance[near], (RADIUS - (xyz[near] - CENTRE) @ room.normals[index]) / sine)
    return distance


def _wall_colours(room: Room, xyz: Array, panel: Indices) -> Array:
    """Return the colours (N, 3) of points on the walls: faint texture, seams, screws, holes, markers, cables, lamps."""
    relative = xyz - CENTRE - RADIUS * room.normals[panel]
    x, y = (np.einsum("nk,nk->n", relative, room.axes[panel, axis]) for axis in (0, 1))
    p = room.phases[panel].T
    texture = 1 + 0.012 * np.sin(19 * x + p[0]) * np.sin(23 * y + p[1]) + 0.012 * np.sin(61 * x + 7 * y + p[2])
    texture += 0.012 * np.sin(83 * y - 11 * x + p[3])
    light = room.shades[panel] * texture * (0.86 + 0.05 * xyz[:, 2]) + 0.16 * _lamp_glow(xyz)
    seam = _seam_distances(room, xyz, panel)
    light *= 1 - 0.62 * (seam < SEAM)
    light *= 1 - 0.75 * _spots(x, y, panel, 0.19, 0.011)
    screws = np.hypot((x + 0.15) % 0.3 - 0.15, (y + 0.15) % 0.3 - 0.15) < 0.007
    light *= 1 - 0.5 * (screws & (seam < 0.3))
    cable = room.cables[panel] & (np.abs(y - 0.12 * np.sin(4 * x + p[0])) < 0.012)
    light = np.where(cable, 0.12, light)
    colour = WALL_COLOUR * room.tints[panel] * light[:, None]
    markers = room.markers[panel]
    marked = np.maximum(np.abs(x - markers[:, 0]), np.abs(y - markers[:, 1])) < markers[:, 2]
    colour[marked] = room.marker_colours[panel[marked]]
    door = (panel == room.door) & (seam > 0.06)
    clutter = 0.07 + 0.05 * np.sin(13 * x[door] + 2) * np.sin(17 * y[door]) + 0.03 * np.sin(47 * x[door] + 31 * y[door])
    colour[door] = clutter[:, None] * [1.1, 0.95, 0.8]
    along, height = _lamp_offsets(xyz)
    colour[(np.abs(along) < LAMP_SIZE[0]) & (np.abs(height) < LAMP_SIZE[1]) & ~door] = LAMP_LIGHT
    return colour


def _spots(x: Array, y: Array, panel: Indices, spacing: float, radius: float) -> NDArray[np.bool_]:
    """Return whether points (N,) are on irregularly placed spots: about one in each second square of a grid."""
    i, j = np.floor(x / spacing), np.floor(y / spacing)
    first = np.sin(127.1 * i + 311.7 * j + 74.7 * panel) * 43758.5
    second = np.sin(269.5 * i + 183.3 * j + 41.3 * panel) * 24634.6
    first, second = first - np.floor(first), second - np.floor(second)
    across, up = x / spacing - i - 0.2 - 0.6 * first, y / spacing - j - 0.2 - 0.6 * second
    is_spot = (first + 3.7 * second) % 1 < 0.5
    return np.asarray(is_spot & (np.hypot(across, up) * spacing < radius * (0.6 + 0.8 * second)))


def _lamp_offsets(xyz: Array) -> tuple[Array, Array]:
    """Return the horizontal distances along the wall and the vertical distances (N,) to the nearest lamp in metres."""
    period = 2 * np.pi / LAMPS
    angle = np.arctan2(xyz[:, 1], xyz[:, 0]) % period - period / 2
    return angle * np.hypot(xyz[:, 0], xyz[:, 1]), xyz[:, 2] - LAMP_HEIGHT


def _lamp_glow(xyz: Array) -> Array:
    """Return the light (N,) of the nearest lamp on points near the wall's foot, at most 1."""
    along, height = _lamp_offsets(xyz)
    return np.asarray(np.exp(-(np.maximum(np.abs(along) - LAMP_SIZE[0], 0) ** 2) / 0.05 - height**2 / 0.12))


def _floor_colours(xyz: Array) -> Array:
    """Return the colours (N, 3) of points on the floor: carpet, brighter near the lamps, with strips of tape."""
    x, y, _ = xyz.T
    fibres = 0.03 * np.sin(37 * x + 3 * y) * np.sin(41 * y - 5 * x) + 0.02 * np.sin(97 * x + 89 * y)
    radius = np.hypot(x, y)
    light = 0.92 + fibres - 0.03 * radius + 0.45 * np.exp(-((radius - 2.5) ** 2) / 0.08) * _lamp_glow(xyz)
    colour = FLOOR_COLOUR * light[:, None]
    cross = (np.minimum(np.abs(x), np.abs(y)) < 0.02) & (radius < 0.14)
    strip = (np.abs(y - 0.4 * x + 1.1) < 0.02) & (np.abs(x) < 0.5)
    colour[cross | strip] = [0.72, 0.7, 0.55]
    return np.asarray(colour)


def _ceiling_colours(xyz: Array) -> Array:
    """Return the colours (N, 3) of points on the ceiling: dark beams and two lamps."""
    x, y, _ = xyz.T
    beams = np.abs((x + 0.275) % 0.55 - 0.275) < 0.03
    light = 1 + 0.08 * np.sin(7 * x + 1) * np.sin(9 * y) - 0.55 * beams
    colour = CEILING_COLOUR * light[:, None]
    lamps = (np.abs(np.abs(x) - 0.6) < 0.09) & (np.abs(y) < 0.5)
    colour[lamps] = LAMP_LIGHT
    return np.asarray(colour)
