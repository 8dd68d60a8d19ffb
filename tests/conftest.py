"""Fixtures that several test files use, and how many cases hypothesis draws.

By default 25 of each law, the same on every run; ``--hypothesis-profile=ci`` (`make test-slow`): 100. Readers of
hostile input say their own number.

``pytest tests/robustness --hypothesis-profile=long`` draws other cases each time, many of them; what fails is kept in
.hypothesis and tried first the next time.
"""

import signal
import threading

import pytest
from hypothesis import HealthCheck, settings

from eagor.errors import MissingExtraError, ServerError, StorageError
from eagor.perception.coco import COCO, install

settings.register_profile("quick", settings.get_profile("ci"), max_examples=25)
settings.register_profile(
    "long", max_examples=2000, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)

# A shell that starts a job with "&" may let it ignore Ctrl-C, and so would each command that a test starts and ends.
if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="module")
def one_thread():
    """PyTorch on one thread: small models are slower on several, and tests run side by side."""
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def coco_model():
    """The file of the real detector, from the user's cache; it is installed there if it can be had."""
    try:
        return install(COCO)
    except (ServerError, StorageError, MissingExtraError) as error:
        pytest.skip(f"the real detector cannot be had: {error}")
