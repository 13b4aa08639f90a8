"""What tests of the objective share."""

import pytest
import torch


@pytest.fixture
def double():
    """Everything in float64, so that slopes can be compared with differences."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)
