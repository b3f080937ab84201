"""The folder of intermediate results: its files, the record of finished stages, and results that are kept."""
