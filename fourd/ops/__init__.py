"""Python interfaces of the native kernels: one folder per kernel of ``csrc``, all with the same structure.

- ``op.py``: the public function. It checks arguments, selects the backend and, where the operation is differentiable,
  registers a ``torch.library`` operator with a fake implementation and its gradient.
- ``reference.py``: a slow and simple implementation. Tests compare every backend with it.

Kernels for playing baked scenes (``shade``, ``play`` and ``points/arrays.py``) take NumPy arrays and do not import
torch. Their CUDA versions, for torch tensors, are in ``cuda.py``.

Modules in this folder import only each other and base modules such as :mod:`fourd.cameras`.
"""
