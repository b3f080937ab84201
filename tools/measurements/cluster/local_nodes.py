"""Starts a Ray cluster of several nodes on this machine, for simulations and measurements. Each node has its own
processes."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[3]
STORE_BYTES = 80 << 20
"""Size of each node's object store. Ray needs at least 75 MB."""
TRAINED = "train "
"""Prefix of the names of the stages that train segments (ranges of frames)."""
PATIENT = 200
"""Value of ``patience`` in :func:`local_nodes` for clusters from which no node is removed. In such a cluster, Ray
does not have to detect lost nodes, so the value can be large."""
TITLE = "ray::"
"""Prefix of the process titles of Ray's workers."""
OTHER_TITLES = ("IDLE", "DashboardAgent", "RuntimeEnvAgent")
"""Words that follow TITLE in the titles of those processes that run no stage: idle workers and a node's agents. Killing
an agent would end its node."""
ATTEMPTS = 5
"""Maximum number of attempts to start a node."""


class LocalNodes:
    """The nodes of a cluster, except for the head node, which has no cores and so runs no stages."""

    def __init__(self, cluster: Any, cores: int) -> None:
        """Use ``cluster``, a ray.cluster_utils.Cluster. Each node has ``cores`` cores."""
        self._cluster = cluster
        self._cores = cores

    @property
    def address(self) -> str:
        """HOST:PORT for ``fourd make --ray``."""
        return str(self._cluster.address)

    def add(self) -> None:
        """Start one more node. If the processes of the node do not answer in time, for example because the machine is
        busy, the start is repeated."""
        for attempt in range(ATTEMPTS):
            try:
                self._cluster.add_node(num_cpus=self._cores, object_store_memory=STORE_BYTES, include_dashboard=False)
                return
            except Exception:
                if attempt == ATTEMPTS - 1:
                    raise

    def remove(self, index: int) -> None:
        """Kill all processes of a node, as if the machine had lost power."""
        self._cluster.remove_node(sorted(self._cluster.worker_nodes, key=id)[index], allow_graceful=False)

    def busy(self) -> list[int]:
        """Return the indices of the nodes that run a stage. :meth:`remove` takes such an index. Needs Linux."""
        raylets = [self._raylet(node) for node in sorted(self._cluster.worker_nodes, key=id)]
        running = {parent for _, parent in self._running().values()}
        return [index for index, raylet in enumerate(raylets) if raylet in running]

    def stages(self) -> dict[int, str]:
        """Return a mapping from the process id of each running stage to the stage's name. Needs Linux."""
        return {process: name for process, (name, _) in self._running().items()}

    @staticmethod
    def _raylet(node: Any) -> int:
        """Return the process id of a node's main process."""
        return int(node.all_processes["raylet"][0].process.pid)

    def _running(self) -> dict[int, tuple[str, int]]:
        """Return a mapping from the process id of each running stage to the stage's name and the id of the parent
        process, which is the main process of the node."""
        raylets = {self._raylet(node) for node in self._cluster.worker_nodes}
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                # Ray sets a worker's process title to the name of its task.
                title = (folder / "cmdline").read_bytes().split(b"\0")[0].decode(errors="replace")
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:  # The process has ended.
                continue
            name = title.removeprefix(TITLE)
            if parent in raylets and name != title and not name.startswith(OTHER_TITLES):
                found[int(folder.name)] = (name, parent)
        return found

    def count(self) -> int:
        """Return the number of nodes."""
        return len(self._cluster.worker_nodes)


@contextmanager
def local_nodes(count: int, cores: int, *, patience: int = 5) -> Iterator[LocalNodes]:
    """Start a cluster of ``count`` nodes with ``cores`` cores each for the duration of the ``with`` block.

    Ray checks every three seconds if each node is alive. A node that gives no answer ``patience`` times in succession
    counts as lost. Use a large ``patience`` on a busy machine, where a running node may not answer for half a minute.

    The nodes may have more cores in total than the machine. In that case, Ray runs one task per core of the nodes, and
    the tasks share the machine's cores.
    """
    from ray._private.utils import get_ray_address_file
    from ray.cluster_utils import Cluster

    # Workers import the tools from the root of the repository.
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    head = {
        "num_cpus": 0,
        "object_store_memory": STORE_BYTES,
        "include_dashboard": False,
        "_system_config": {"health_check_failure_threshold": patience},
    }
    cluster = Cluster(initialize_head=True, head_node_args=head)
    try:
        # Ray writes the cluster's address to a file, in which "--ray auto" looks for a cluster. The file is removed, so
        # that other programs on this machine do not join this cluster.
        Path(get_ray_address_file(None)).unlink(missing_ok=True)
        nodes = LocalNodes(cluster, cores)
        for _ in range(count):
            nodes.add()
        yield nodes
    finally:
        cluster.shutdown()


def store_bytes(ray: Any) -> int:
    """Return the number of bytes in the object stores of all nodes of the cluster to which ``ray`` is connected."""
    from ray._private.internal_api import get_memory_info_reply, get_state_from_address

    state = get_state_from_address(ray.get_runtime_context().gcs_address)
    return int(get_memory_info_reply(state).store_stats.object_store_bytes_used)


def cpu_seconds(process: int) -> float:
    """Return the CPU time of a process, including all its threads. Needs Linux."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_bytes() -> int:
    """Return the resident memory of this process in bytes. Needs Linux."""
    if sys.platform != "linux":
        sys.exit("expected Linux, whose /proc has the memory of this process")
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
