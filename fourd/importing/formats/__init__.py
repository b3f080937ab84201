"""One module per format. Each module reads a source into an :class:`~fourd.importing.imported.Imported`.

To add a format:

1. ``formats/NAME.py``: ``looks_like(source) -> bool``, from file names and first bytes alone, and
   ``read(source) -> Imported``, with cameras in fourd's conventions; helpers are in ``importing/folders.py``.
2. ``importing/detection.py``: the module in FORMATS, before less specific formats. Help texts list it from there.
3. ``tests/importing/formats/test_NAME.py``: round trip, missing files, ``assert_damage_is_reported``.
"""
