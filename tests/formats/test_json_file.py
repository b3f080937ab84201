"""The typed decoder of JSON: valid content, and one error of one line for each kind of invalid content."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from msgspec import Meta
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.json_file import Finite, Matrix, decode_json, read_json_as, require_printable


@dataclass(frozen=True)
class Item:
    count: Annotated[int, Meta(ge=0, le=9)]
    share: Finite = 0.5

    def __post_init__(self) -> None:
        if self.count == 7:
            raise ValueError("count: expected another number than 7, got 7")


@dataclass(frozen=True, eq=False)
class Content:
    items: tuple[Item, ...]
    by_name: dict[str, Item]
    kind: Literal["a", "b"] = "a"
    rate: Fraction = Fraction(25)
    note: str | None = None
    is_on: bool = False
    rotation: Matrix = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    values: NDArray[np.float32] | None = None


def test_valid_content_is_decoded(tmp_path: Path) -> None:
    """Catches values that are rounded or of another type, defaults that are not used, and unknown keys that are
    refused."""
    path = tmp_path / "a.json"
    path.write_text(
        '{"items": [{"count": 3, "new": [{}]}, {"count": 4, "share": 1}], "by_name": {"\\ud800": {"count": 1}}, '
        '"rate": "30000/1001", "note": null, "values": [1, 0.1]}'
    )
    found = read_json_as(path, Content)
    assert found.items == (Item(3), Item(4, 1.0))
    assert isinstance(found.items[1].share, float)
    assert found.by_name == {"\ud800": Item(1)}, "JSON can contain file names that are not UTF-8"
    assert (found.kind, found.rate, found.note, found.is_on) == ("a", Fraction(30000, 1001), None, False)
    assert found.values is not None
    assert found.values.dtype == np.float32
    assert found.values.tolist() == np.float32([1, 0.1]).tolist()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"items": 3}, "items: expected a list, got 3"),
        ({"items": [4]}, "items[0]: expected a JSON object, got 4"),
        ({"items": [{}]}, 'items[0]: expected a key "count", got none'),
        ({"items": [{"count": 1}, {"count": -1}]}, "items[1], count: expected a whole number >= 0, got -1"),
        ({"items": [{"count": 10**400}]}, "items[0], count: expected a whole number <= 9, got 100000000000000000"),
        ({"items": [{"count": 1.0}]}, "items[0], count: expected a whole number, got 1.0"),
        ({"items": [{"count": True}]}, "items[0], count: expected a whole number, got True"),
        ({"items": [{"count": 1, "share": True}]}, "items[0], share: expected a number, got True"),
        ({"items": [{"count": 1, "share": float("inf")}]}, "items[0], share: expected a number < 1e+30, got inf"),
        ({"items": [{"count": 1, "share": float("nan")}]}, "items[0], share: expected a number > -1e+30, got nan"),
        ({"items": [{"count": 1, "share": 10**400}]}, "items[0], share: expected a value that is possible here, got"),
        ({"items": [{"count": 7}]}, "items[0], count: expected another number than 7, got 7"),
        ({"by_name": {"x\n": {"count": "1"}}}, "by_name[...], count: expected a whole number, got another value"),
        ({"kind": "c - at `$.x`\n"}, "kind: expected a value that is possible here, got 'c - at `$.x`\\n'"),
        ({"rate": "1/0"}, "rate: expected a fraction, got a division by zero"),
        ({"rate": "1e99999999"}, "rate: expected a number of at most 64 characters"),
        ({"note": 3}, "note: expected text or null, got 3"),
        ({"is_on": 1}, "is_on: expected true or false, got 1"),
        ({"rotation": [[1, 0, 0], [0, 1], [0, 0, 1]]}, "rotation[1]: expected a list of length 3, got [0, 1]"),
        ({"values": [1, "2"]}, "values, [1]: expected a number, got '2'"),
        ({"values": [[1]]}, "values, [0]: expected a number, got [1]"),
    ],
)
def test_invalid_content_is_refused(change: dict[str, Any], message: str) -> None:
    """Catches a value of a wrong type or out of range that is used, and a message that does not name its place, or
    that has the control characters of the file."""
    content = {"items": [], "by_name": {}}
    decode_json(content, Content)
    with pytest.raises(ValueError, match="expected") as caught:
        decode_json(content | change, Content)
    assert str(caught.value).startswith(message)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"3", "expected a JSON object, got 3"),
        (b"{}", 'expected a key "items", got none'),
        (b"", "expected UTF-8 JSON, got other content"),
        (b'{"items": [], "by_name": {}} x', "expected UTF-8 JSON, got other content"),
        (b'{"items": [], "by_name": {}, "note": "\xff"}', "expected UTF-8 JSON, got other content"),
        ('{"items": [], "by_name": {}}'.encode("utf-16"), "expected UTF-8 JSON, got other content"),
        (b'{"items": ' + b"[" * 100_000, r"expected UTF-8 JSON, got other content \(deeply nested lists\)"),
        (b'{"items": [{"count": ' + b"9" * 5000 + b"}]}", "expected UTF-8 JSON, got other content"),
        (b'{"items": [{"count": 1, "share": 1e999}], "by_name": {}}', r"items\[0\], share: expected .* got inf"),
    ],
)
def test_other_files_are_refused(text: bytes, message: str, tmp_path: Path) -> None:
    """Catches exceptions other than ValueError for files that are not JSON, or not JSON of this type."""
    (tmp_path / "a.json").write_bytes(text)
    with pytest.raises(ValueError, match=message):
        read_json_as(tmp_path / "a.json", Content)


def test_large_files_are_refused(tmp_path: Path) -> None:
    """Catches a decoder that reads files of any size into memory."""
    (tmp_path / "a.json").write_text('{"count": 1}')
    assert read_json_as(tmp_path / "a.json", Item, 12) == Item(1)
    with pytest.raises(UserError, match=r"a.json: expected at most"):
        read_json_as(tmp_path / "a.json", Item, 11)


def test_texts_are_printable() -> None:
    """Catches a name from a file that adds lines to the output."""
    require_printable("name", "ü 05")
    with pytest.raises(ValueError, match=r"^name: expected printable text, got 'a\\nb'$"):
        require_printable("name", "a\nb")
