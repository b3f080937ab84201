"""The formats and modes of an import, in a module without dependencies, so that help texts can list them quickly."""

from typing import Literal

FORMAT_NAMES = (
    "qualisys",
    "caliscope",
    "anipose",
    "neural3dv",
    "panoptic-sports",
    "actorshq",
    "dna-rendering",
    "transforms",
    "colmap",
    "easymocap",
    "videos",
)
"""Names of the formats, in the order of :data:`fourd.recording.importing.detection.FORMATS`."""

SyncMethod = Literal["auto", "sound", "motion"]
CalibratedFrames = Literal["auto", "turned", "stored"]
"""Frames to which a calibration belongs: "stored" are the frames as the file stores them, and "turned" are the frames
after they are turned upright by the rotation in the video's metadata. "auto" selects the frames that have the same
orientation (portrait or landscape) as the images of the calibration, or "turned" if the orientation does not decide."""
PairBy = Literal["auto", "name", "order"]
"""How images of different cameras are paired. "name": images with the same frame name or frame number belong together.
"order": the first images of all cameras belong together, and so on. "auto" is "name", but raises an error if the names
leave doubt."""
PrincipalPointMode = Literal["auto", "as-given", "mirrored"]
