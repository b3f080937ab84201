"""Frame numbers in the names of files with one file per frame."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from fourd.base.files import natural_key

DIGITS = re.compile(r"\d+")
MIN_OVERLAP = 0.5
"""If several numbers in the names vary, one of them is taken as the frame number only if this fraction of its values is
the same in all cameras."""
MAX_NUMBER = 10**15
"""Numbers from this one on are not frame numbers of a sequence, because other programs may round them."""


def varying_numbers_of(stems: Mapping[str, Sequence[str]]) -> dict[str, list[int]] | None:
    """Return the frame numbers in the file names of several cameras, or None if the names do not determine them.

    The frame number is the only number that varies within a camera. It may be at another place in each camera's names.
    If several numbers vary, such as a frame number and a time stamp, the one that agrees between the cameras is used.
    """
    tables = {camera: _number_table(names) for camera, names in stems.items() if names}
    if not tables or any(table is None for table in tables.values()):
        return None
    columns = {camera: table for camera, table in tables.items() if table is not None}
    varying = {camera: _varying_columns(table) for camera, table in columns.items() if len(stems[camera]) > 1}
    if any(not found for found in varying.values()):
        return None
    if all(len(found) == 1 for found in varying.values()):
        chosen = {camera: found[0] for camera, found in varying.items()}
    else:
        common = _agreeing_column({camera: columns[camera] for camera in varying}, varying)
        if common is None:
            return None
        chosen = dict.fromkeys(varying, common)
    used = set(chosen.values())
    usual = used.pop() if len(used) == 1 else -1
    result: dict[str, list[int]] = {camera: [] for camera in stems}
    for camera, table in columns.items():
        # A camera with one image has no varying number; its number is where the other cameras have theirs.
        place = chosen.get(camera, usual if -usual <= len(table) else -1)
        if not table:
            return None
        result[camera] = table[place]
    return result


def varying_numbers(stems: Sequence[str]) -> list[int] | None:
    """Return the number that varies in a list of file names. None unless exactly one varies and it differs between all
    names."""
    found = varying_numbers_of({"": stems})
    return None if found is None else found[""]


def sort_sequence(stems: Sequence[str]) -> tuple[list[int], tuple[int, ...]]:
    """Order the files of a sequence with one file per frame, such as meshes or splats.

    Args:
        stems: file names without suffix.

    Returns:
        Indices into ``stems`` in the order of the frames, and the frame numbers in this order. The frame number is the
        number that varies in the names, or else the last number. If the numbers are not unique, files are in natural
        order and are numbered from 0.
    """
    last = [[int(digits) for digits in DIGITS.findall(stem)[-1:]] for stem in stems]
    numbers = varying_numbers(stems) or [number for each in last for number in each]
    if len(set(numbers)) == len(numbers) == len(stems) and max(numbers, default=0) < MAX_NUMBER:
        order = sorted(range(len(stems)), key=lambda index: numbers[index])
        return order, tuple(numbers[index] for index in order)
    order = sorted(range(len(stems)), key=lambda index: natural_key(stems[index]))
    return order, tuple(range(len(stems)))


def _number_table(names: Sequence[str]) -> list[list[int]] | None:
    """Return the numbers in ``names``, one list for each place. None if the names differ in more than their numbers."""
    if len({DIGITS.sub("#", name) for name in names}) != 1:
        return None
    rows = [[int(digits) for digits in DIGITS.findall(name)] for name in names]
    return [list(column) for column in zip(*rows, strict=True)]


def _varying_columns(table: list[list[int]]) -> list[int]:
    """Return the places, counted from the end as negative indices, of numbers that differ between all names."""
    varies = [index - len(table) for index, column in enumerate(table) if len(set(column)) > 1]
    unique = [index for index in varies if len(set(table[index])) == len(table[index])]
    return unique if len(varies) > 1 or len(unique) == 1 else []


def _agreeing_column(tables: Mapping[str, list[list[int]]], varying: Mapping[str, list[int]]) -> int | None:
    """Return the place whose numbers agree best between the cameras, or None if none agrees well and clearly best."""
    if len(tables) < 2:
        return None
    scores = []
    for place in set.intersection(*(set(found) for found in varying.values())):
        sets = [set(table[place]) for table in tables.values()]
        scores.append((len(set.intersection(*sets)) / len(set.union(*sets)), place))
    scores.sort(reverse=True)
    if not scores or scores[0][0] < MIN_OVERLAP or (len(scores) > 1 and scores[1][0] == scores[0][0]):
        return None
    return scores[0][1]
