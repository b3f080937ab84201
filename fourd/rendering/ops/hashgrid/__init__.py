"""Multi-resolution hash encoding (``csrc/hashgrid``)."""
