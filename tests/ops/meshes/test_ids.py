import math

import torch

from fourd.rendering.ops.meshes.ids import decode_ids, encode_ids


def test_ids_round_trip_around_the_last_exact_float() -> None:
    """Catches ids above 2^24 that are rounded to their even neighbours."""
    triangle = torch.tensor([-1, 0, 1, 2**24 - 2, 2**24 - 1, 2**24, 2**24 + 1, 2**25 + 3], dtype=torch.int32)
    value = encode_ids(triangle)
    assert value[0] == 0
    assert torch.equal(value[:3], torch.tensor([0.0, 1.0, 2.0]))
    assert torch.equal(decode_ids(value), triangle)
    assert bool((value[1:] > value[:-1]).all())


def test_values_that_are_no_ids_are_background() -> None:
    """Catches casts of NaN and negative values to arbitrary triangles."""
    assert decode_ids(torch.tensor([0.0, -3.0, math.nan, 0.5])).tolist() == [-1, -1, -1, -1]
