"""The image encoder as one operator (``csrc/encoder``)."""
