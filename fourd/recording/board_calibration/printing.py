"""Boards as PDF files that print at true scale.

The PDF contains the pattern as rectangles in points (1/72 inch), so that the size of a square is exact at any
resolution (ISO 32000-1, sec. 8.5).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import write_bytes_atomically
from fourd.recording.boards import CalibrationBoard, ink_rectangles

Array = NDArray[np.float64]

POINTS_PER_MM = 72 / 25.4
PAGES_MM = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "a2": (420.0, 594.0), "letter": (215.9, 279.4)}
MARGIN_MM = 5.0
"""Smallest margin of the page. Most printers cannot print closer to the edge of the paper."""
NOTE_MM = 8.0
"""Height of the strip below the board. The strip contains a ruler and a note that describes the board."""
RULER_MM = 100.0


def print_board(path: Path, board: CalibrationBoard, page: str) -> tuple[float, float]:
    """Write a PDF with the board at true scale; a double-sided board has a second page for its back.

    The board is turned by 90 degrees if it fits the page only after the turn.

    Args:
        path: file to write.
        board: the board.
        page: A4, A3, A2, letter, or WIDTHxHEIGHT in millimetres.

    Returns:
        width and height of the page in millimetres.

    Raises:
        UserError: if the page is unknown, or the board is too large for it.
    """
    size = page_size(page)
    width, height = (1e3 * side for side in board.size_m)
    available = size[0] - 2 * MARGIN_MM, size[1] - 2 * MARGIN_MM - NOTE_MM
    turned = not (width <= available[0] and height <= available[1])
    if turned and not (height <= available[0] and width <= available[1]):
        least = [f"{width + 2 * MARGIN_MM:.0f}", f"{height + 2 * MARGIN_MM + NOTE_MM:.0f}"]
        raise UserError(
            f"--page: expected a page for a board of {width:g} x {height:g} mm, got {size[0]:g} x {size[1]:g} mm; use "
            f"--page {'x'.join(least)} or smaller squares"
        )
    sides = [_page_content(board, size, turned, mirrored) for mirrored in (False, True)[: 1 + board.double_sided]]
    write_bytes_atomically(path, _document(size, sides))
    return size


def page_size(page: str) -> tuple[float, float]:
    """Return the width and height, in millimetres, of the page that the text ``page`` describes: A4, A3, A2, letter, or
    WIDTHxHEIGHT. Raises UserError for any other text."""
    if page.lower() in PAGES_MM:
        return PAGES_MM[page.lower()]
    width, _, height = page.lower().partition("x")
    try:
        size = float(width), float(height)
    except ValueError:
        size = 0.0, 0.0
    if not all(10 < side < 5000 for side in size):
        raise UserError(
            f"--page: expected {', '.join(PAGES_MM)} or WIDTHxHEIGHT in millimetres, got '{page}'; write for example "
            "600x400"
        )
    return size


def _page_content(board: CalibrationBoard, size: tuple[float, float], turned: bool, mirrored: bool) -> bytes:
    """Return the PDF operators that draw a page. Coordinates are in points from the lower left corner."""
    width, height = (1e3 * side for side in board.size_m)
    rectangles = 1e3 * ink_rectangles(board)
    ground = np.array([[0.0, 0.0, width, height]])
    if mirrored:
        rectangles = np.column_stack(
            [width - rectangles[:, 2], rectangles[:, 1], width - rectangles[:, 0], rectangles[:, 3]]
        )
    if turned:
        rectangles, ground = (
            np.column_stack([height - some[:, 3], some[:, 0], height - some[:, 1], some[:, 2]])
            for some in (rectangles, ground)
        )
        width, height = height, width
    left, bottom = (size[0] - width) / 2, NOTE_MM + (size[1] - NOTE_MM - height) / 2
    shift = np.array([left, bottom, left, bottom])
    lines = ["0 g"]
    if board.inverted:
        lines += [_rectangle(ground[0] + shift), "1 g"]
    lines += [_rectangle(each) for each in rectangles + shift]
    side = " back, mirrored" if mirrored else ""
    note = f"{board.describe()}{side}. Print at 100% (actual size): this line is {RULER_MM:g} mm long."
    lines += ["0 g", _rectangle(np.array([left, bottom - 4, left + min(RULER_MM, width), bottom - 3.7]))]
    if width < RULER_MM:
        note = note.replace(f"{RULER_MM:g} mm", f"{width:g} mm")
    points = left * POINTS_PER_MM, (bottom - 7.5) * POINTS_PER_MM
    lines.append(f"BT /F1 7 Tf {points[0]:.3f} {points[1]:.3f} Td ({note.replace('(', '').replace(')', '')}) Tj ET")
    return "\n".join(lines).encode("ascii")


def _rectangle(edges_mm: Array) -> str:
    x0, y0, x1, y1 = edges_mm * POINTS_PER_MM
    return f"{x0:.4f} {y0:.4f} {x1 - x0:.4f} {y1 - y0:.4f} re f"


def _document(size: tuple[float, float], contents: list[bytes]) -> bytes:
    """Return a PDF file with one page for each item of ``contents``."""
    box = f"[0 0 {size[0] * POINTS_PER_MM:.4f} {size[1] * POINTS_PER_MM:.4f}]"
    pages = [4 + 2 * number for number in range(len(contents))]
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{' '.join(f'{page} 0 R' for page in pages)}] /Count {len(pages)} >>".encode(),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    for page, content in zip(pages, contents, strict=True):
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents {page + 1} 0 R "
            "/Resources << /Font << /F1 3 0 R >> >> >>".encode()
        )
        objects.append(b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content))
    parts, offsets = [b"%PDF-1.6\n"], []
    for number, body in enumerate(objects, 1):
        offsets.append(sum(map(len, parts)))
        parts.append(b"%d 0 obj\n%s\nendobj\n" % (number, body))
    table = sum(map(len, parts))
    entries = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    parts.append(b"xref\n0 %d\n0000000000 65535 f \n%s" % (len(objects) + 1, entries))
    parts.append(b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table))
    return b"".join(parts)
