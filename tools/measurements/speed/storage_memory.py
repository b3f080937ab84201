"""Measure the peak memory of uploading and downloading files of several sizes. The S3 server is a separate local
process.

python tools/measurements/speed/storage_memory.py --megabytes 32 512
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import fsspec

from fourd.base.storage import StorageUrl, fetch, upload
from tests.storage.s3_server import ENVIRONMENT, S3Server
from tools.measurements import tables


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--megabytes", type=int, nargs="+", default=[32, 512])
    parser.add_argument("--child", nargs=3, metavar=("WORK", "URL", "PATH"), help="run one transfer in this process")
    arguments = parser.parse_args()
    os.environ.update(ENVIRONMENT)
    if arguments.child is None:
        measure(arguments.megabytes)
    elif arguments.child[0] == "serve":
        print(S3Server.start().endpoint, flush=True)
        sys.stdin.read()  # returns when the parent process ends
    else:
        transfer(*arguments.child)


def transfer(work: str, url: str, path: str) -> None:
    """Upload or download a file, and print the peak memory of this process in MB."""
    if work == "upload":
        upload(Path(path), StorageUrl(url))
    else:
        fetch(StorageUrl(url), Path(path))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)


def measure(sizes: list[int]) -> None:
    """Print one table row for each file size."""
    this = [sys.executable, __file__, "--child"]
    server = subprocess.Popen(
        [*this, "serve", "", ""], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert server.stdout is not None
    os.environ["AWS_ENDPOINT_URL"] = server.stdout.readline().strip()
    fsspec.filesystem("s3").mkdir("bucket")
    print(tables.head(["file, MB", "upload, MB", "copy, MB"]))
    try:
        for size in sizes:
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "video.mp4"
                with file.open("wb") as out:
                    for _ in range(size):
                        out.write(os.urandom(1 << 20))
                row = [size]
                for work, path in (("upload", file), ("copy", Path(folder) / "copy")):
                    words = [*this, work, f"s3://bucket/{size}/video.mp4", str(path)]
                    row.append(int(subprocess.run(words, check=True, capture_output=True, text=True).stdout))
            print(tables.row(row), flush=True)
    finally:
        server.kill()


if __name__ == "__main__":
    main()
