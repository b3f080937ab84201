"""The Python side of the native kernels: one folder per kernel of ``csrc``, all built the same way.

- ``op.py``: the public function. It checks arguments, selects the backend and, where the operation is differentiable,
  registers a ``torch.library`` operator with a fake implementation and its gradient.
- ``reference.py``: the same computation, slow and obvious. Tests hold every backend to it.

Kernels that play baked scenes (``shade``, ``play``, and ``points/arrays.py``) take NumPy arrays and import no torch;
their CUDA versions for torch tensors are in ``cuda.py``.

Modules here import only each other and the base modules (:mod:`fourd.cameras` and the like).
"""
