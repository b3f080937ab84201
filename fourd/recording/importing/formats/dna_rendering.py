"""DNA-Rendering: NAME.smc (HDF5) with encoded images, NAME_annots.smc with calibration and mattes.

In later parts of the data set, NAME.smc contains the calibration. The matrix RT is a camera-to-world pose in metres.
The data set's tools use OpenCV, in which the origin of pixel coordinates is the centre of the first pixel. In fourd,
the origin is the corner of the first pixel, so half a pixel is added to the principal points.
"""

from __future__ import annotations

from pathlib import Path

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.importing.folders import list_entries, make_camera, read_head
from fourd.recording.importing.imported import EncodedPictures, Imported, ImportedCamera
from fourd.recording.importing.readers.hdf5 import Hdf5File

SUFFIX = ".smc"
ANNOTATIONS = "_annots.smc"
MAGIC = b"\x89HDF\r\n\x1a\n"
GROUPS = ("Camera_5mp", "Camera_12mp")


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a file NAME.smc, or a folder with such a file."""
    return any(read_head(path, len(MAGIC)) == MAGIC for path in _find_files(source))


def read(source: Path) -> Imported:
    """Read the cameras of ``source``.

    Lengths are in metres. Camera names are two-digit numbers. Images are read one at a time.

    Raises:
        UserError: when there is no NAME.smc or more than one, the file is not HDF5, the file refers to other files, a
            group or a value is missing, or the numbers of mattes and images differ.
    """
    files = _find_files(source)
    if len(files) != 1:
        got = " and ".join(path.name for path in files) or "none"
        raise UserError(f"{source}: expected one NAME{SUFFIX}, got {got}; name the file itself")
    path, annotations = files[0], _find_annotations(files[0])
    pictures: dict[int, tuple[EncodedPictures, tuple[int, int]]] = {}
    main = Hdf5File(path)
    for group in GROUPS:
        for number, group_path in main.numbered(group, required=False).items():
            pictures[number] = main.encoded(f"{group_path}/color")
    if not pictures:
        raise UserError(f"{path}: expected the group {' or '.join(GROUPS)}, got neither; download it again")
    has_calibration = main.has("Camera_Parameter")
    calibrations = _read_cameras(main, pictures) if has_calibration else {}
    masks: dict[int, EncodedPictures] = {}
    if annotations is not None:
        annotated = Hdf5File(annotations)
        if not has_calibration:
            calibrations = _read_cameras(annotated, pictures)
        for number, group_path in annotated.numbered("Mask", required=False).items():
            masks[number] = annotated.encoded(f"{group_path}/mask")[0]
    elif not has_calibration:
        raise UserError(
            f"{path}: expected the group Camera_Parameter in this file or in {path.stem}{ANNOTATIONS}, got neither; "
            "put the annotations beside this file"
        )
    cameras = []
    for number, (frames, _) in sorted(pictures.items()):
        mattes = masks.get(number)
        if mattes is not None and mattes.names != frames.names:
            wrong = min(set(mattes.names) ^ set(frames.names))
            raise UserError(
                f"{annotations}: Mask/{number}: expected {frames.count} mattes, one for each image, "
                f"got {mattes.count} (first difference: frame {int(wrong)}); download it again"
            )
        cameras.append(ImportedCamera(f"{number:02d}", calibrations.get(number), frames, mattes))
    notes = [
        "metres are kept; poses are inverted from camera-to-world to world-to-camera",
        "half a pixel is added to the principal points, because the origin was the first pixel's centre",
        "colours are kept: Color_Calibration is not applied",
    ]
    uncalibrated = [camera.name for camera in cameras if camera.calibration is None]
    notes += [f"without calibration: {', '.join(uncalibrated)}"] if uncalibrated else []
    return Imported(tuple(cameras), tuple(notes))


def _read_cameras(smc: Hdf5File, pictures: dict[int, tuple[EncodedPictures, tuple[int, int]]]) -> dict[int, Camera]:
    """Read the calibrations of the cameras in ``pictures`` from the group Camera_Parameter.

    ``pictures`` also contains the image sizes. The result is keyed by camera number.
    """
    cameras = {}
    for number, group_path in smc.numbered("Camera_Parameter").items():
        if number not in pictures:
            continue
        intrinsics = smc.array(f"{group_path}/K", (3, 3))
        intrinsics[:2, 2] += 0.5
        pose_world_camera = smc.array(f"{group_path}/RT", (4, 4))
        R_camera_world = pose_world_camera[:3, :3].T
        translation = -R_camera_world @ pose_world_camera[:3, 3]
        distortion = smc.array(f"{group_path}/D", (-1,))
        where = f"{smc.path}: {group_path}"
        cameras[number] = make_camera(where, intrinsics, R_camera_world, translation, pictures[number][1], distortion)
    return cameras


def _find_files(source: Path) -> list[Path]:
    candidates = [source / name for name in list_entries(source)] or [source]
    return [path for path in candidates if path.name.endswith(SUFFIX) and not path.name.endswith(ANNOTATIONS)]


def _find_annotations(path: Path) -> Path | None:
    """Find NAME_annots.smc beside NAME.smc or in ../annotations/. The data set has NAME.smc in the folder main/, and
    NAME_annots.smc in the folder annotations/ beside main/."""
    name = f"{path.stem}{ANNOTATIONS}"
    paths = [path.with_name(name), path.parent.parent / "annotations" / name]
    return next((found for found in paths if found.is_file()), None)
