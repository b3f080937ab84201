"""Space carving: computes the bounds of the scene and initial coloured points from the masks and images of a
capture.

Importing this package imports none of its modules; the first use of a public name imports the module of this name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Bounds": "bounds",
        "CarvedFrame": "carve",
        "carve_capture": "sequence",
        "carve_frame": "carve",
        "colour_points": "colour",
        "find_bounds": "bounds",
        "hull_bounds": "bounds",
        "read_bounds": "sequence",
    },
)
