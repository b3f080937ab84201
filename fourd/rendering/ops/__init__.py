"""Python interfaces of the native kernels: one folder per kernel of ``csrc``, all with the same structure.

- ``op.py``: the public function, which checks arguments and selects the backend. For a differentiable operation,
  ``op.py`` also registers a ``torch.library`` operator, its fake implementation and its gradient.
- ``reference.py``: a slow and simple implementation with which tests compare every backend.

The functions that draw baked (exported) scenes, in ``shade``, ``play`` and ``points/arrays.py``, take NumPy arrays and
do not import torch. Their CUDA versions are in ``cuda.py`` and take torch tensors.

Modules in this folder import only each other and base modules such as :mod:`fourd.base.cameras`.
"""
