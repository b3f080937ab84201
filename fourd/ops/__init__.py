"""One folder a kernel of ``csrc``: the operator, its reference, and both backends."""
