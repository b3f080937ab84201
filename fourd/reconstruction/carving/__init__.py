"""Space carving: computes the bounds of the scene and initial coloured points from the masks and images of a
capture."""

from fourd.reconstruction.carving.bounds import Bounds, find_bounds, hull_bounds
from fourd.reconstruction.carving.carve import CarvedFrame, carve_frame
from fourd.reconstruction.carving.colour import colour_points
from fourd.reconstruction.carving.sequence import carve_capture, read_bounds

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
