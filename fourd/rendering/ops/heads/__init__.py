"""The networks of the point model as one operator (``csrc/heads``)."""
