"""Storage by URL: copies captures from object stores, and reads and writes scenes in them."""

from fourd.base.storage.downloading import download, fetch, find_objects, is_file_name, list_objects
from fourd.base.storage.local import local_copy, local_output
from fourd.base.storage.objects import read_object, remove_objects
from fourd.base.storage.ranges import open_object
from fourd.base.storage.uploading import (
    check_writable,
    upload,
    upload_all,
    upload_changed,
)
from fourd.base.storage.url import Location, StorageUrl, local_path, parse_location

__all__ = [
    "Location",
    "StorageUrl",
    "check_writable",
    "download",
    "fetch",
    "find_objects",
    "is_file_name",
    "list_objects",
    "local_copy",
    "local_output",
    "local_path",
    "open_object",
    "parse_location",
    "read_object",
    "remove_objects",
    "upload",
    "upload_all",
    "upload_changed",
]
