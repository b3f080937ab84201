"""How many examples the property tests draw: quick in the normal suite, long in the slow one.

A failing test prints the smallest example that fails. The examples are new in every run, and nothing is stored.
"""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings

QUICK = settings(
    max_examples=60,
    deadline=None,
    database=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
)
LONG = settings(QUICK, max_examples=5_000)

EFFORTS = pytest.mark.parametrize(
    "effort", [pytest.param(QUICK, id="quick"), pytest.param(LONG, id="long", marks=pytest.mark.slow)]
)
"""Runs a test with both efforts. The test gets the settings of the property that it defines."""
