"""Storage by URL: captures are copied from object stores, and scenes are read from and written to object stores."""

from fourd.storage.downloading import fetch, list_objects
from fourd.storage.local import local_copy, local_output
from fourd.storage.ranges import open_object
from fourd.storage.uploading import check_writable, upload, upload_changed
from fourd.storage.url import Location, StorageUrl, local_path, parse_location

__all__ = [
    "Location",
    "StorageUrl",
    "check_writable",
    "fetch",
    "list_objects",
    "local_copy",
    "local_output",
    "local_path",
    "open_object",
    "parse_location",
    "upload",
    "upload_changed",
]
