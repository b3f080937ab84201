"""Executes notebooks, and takes pictures of their players."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tests.viewer.web.notebook.host import Kernel
from tests.viewer.web.page import PlayerPage

CELL_SECONDS = 300
"""Time limit of each cell. The limit is long, because machines that run tests may be busy."""


@contextmanager
def executed(*source: str | Path) -> Iterator[tuple[nbformat.NotebookNode, Kernel]]:
    """A notebook that a kernel has executed, and the kernel, which runs until the block ends.

    Args:
        source: the notebook's file, or the code of each cell.
    """
    if isinstance(source[0], Path):
        notebook = nbformat.read(source[0], as_version=4)
    else:
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(each) for each in source])
    client = nbclient.NotebookClient(notebook, timeout=CELL_SECONDS, store_widget_state=True)
    with client.setup_kernel():
        for index, cell in enumerate(notebook.cells):
            client.execute_cell(cell, index)
        client.set_widgets_metadata()
        kernel = Kernel(client.km.get_connection_info())
        try:
            yield notebook, kernel
        finally:
            kernel.close()


def pixels_of(page: PlayerPage) -> NDArray[Any]:
    """The player as the user sees it, (H, W, 3) int16."""
    picture = Image.open(io.BytesIO(page.page.locator("fourd-player").screenshot()))
    return np.asarray(picture.convert("RGB"), np.int16)
