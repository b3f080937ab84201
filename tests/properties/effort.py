"""Numbers of examples that the property tests draw. The normal test suite uses QUICK, and tests with the mark slow use
LONG.

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
"""Runs a test twice: with the setting QUICK, and with the setting LONG. The test applies the setting to the property
that it checks."""
