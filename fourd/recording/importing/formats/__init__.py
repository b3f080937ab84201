"""Importers, one module per format. Each importer reads a source into an
:class:`~fourd.recording.importing.imported.Imported`.

To add a format:

1. Write ``formats/NAME.py`` with two functions. ``looks_like(source) -> bool`` reads only file names and the first
   bytes of files. ``read(source) -> Imported`` returns cameras in fourd's conventions. Shared helper functions are in
   ``importing/folders.py``.
2. Add the module to FORMATS in ``importing/detection.py``, before less specific formats, with ``is_metric=True`` if its
   calibrations are in metres. Help texts list the formats from FORMATS.
3. Write ``tests/importing/formats/test_NAME.py`` with tests of a round trip, of missing files, and of damaged files
   (``assert_damage_is_reported``).
"""
