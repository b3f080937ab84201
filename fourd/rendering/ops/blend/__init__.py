"""Blend logits of points in source views (``csrc/blend``). The colours of the views are blended with weights that are
the softmax of a point's logits over the views, times the point's visibility in each view."""
