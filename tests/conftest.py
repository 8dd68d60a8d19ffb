"""Fixtures that several test files use."""

import pytest


@pytest.fixture(scope="module")
def one_thread():
    """PyTorch on one thread: small models are slower on several, and tests run side by side."""
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
