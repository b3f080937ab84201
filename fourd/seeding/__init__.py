"""Space carving: a capture's masks to first points, their colours and the scene's bounds."""

from fourd.seeding.bounds import Bounds, find_bounds, hull_bounds
from fourd.seeding.carve import CarvedFrame, carve_frame
from fourd.seeding.colour import colour_points
from fourd.seeding.ply import CarvedPoints, read_ply, write_ply
from fourd.seeding.sequence import carve_capture, read_bounds

__all__ = [
    "Bounds",
    "CarvedFrame",
    "CarvedPoints",
    "carve_capture",
    "carve_frame",
    "colour_points",
    "find_bounds",
    "hull_bounds",
    "read_bounds",
    "read_ply",
    "write_ply",
]
