"""Space carving: computes the bounds of the scene and initial coloured points from the masks and images of a
capture."""

from fourd.carving.bounds import Bounds, find_bounds, hull_bounds
from fourd.carving.carve import CarvedFrame, carve_frame
from fourd.carving.colour import colour_points
from fourd.carving.sequence import carve_capture, read_bounds

__all__ = [
    "Bounds",
    "CarvedFrame",
    "carve_capture",
    "carve_frame",
    "colour_points",
    "find_bounds",
    "hull_bounds",
    "read_bounds",
]
