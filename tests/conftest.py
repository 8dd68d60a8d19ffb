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
from eagor.perception.coco import install

settings.register_profile("quick", settings.get_profile("ci"), max_examples=25)
settings.register_profile(
    "long", max_examples=2000, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)

# A shell that starts a job with "&" may let it ignore Ctrl-C, and so would each command that a test starts and ends.
if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# The long files first, so that no worker is left alone with one at the end; laws are short and many.
ORDER = ("end_to_end", "robustness", "contracts", "golden", "oracles", "laws")


def pytest_collection_modifyitems(items):
    """Tests in real time first, which are one group and wait a lot; then folder by folder."""
    place = {name: number for number, name in enumerate(ORDER)}
    items.sort(
        key=lambda item: (item.get_closest_marker("xdist_group") is None, place.get(item.path.parent.name, len(ORDER)))
    )


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Tests of a file run in one process, as a group does: what they share is made once."""
    if config.getvalue("dist") != "loadgroup":
        return None
    from xdist.scheduler import LoadGroupScheduling

    class ByFile(LoadGroupScheduling):
        def _split_scope(self, nodeid):
            scope = super()._split_scope(nodeid)
            return nodeid.partition("::")[0] if scope == nodeid else scope

    return ByFile(config, log)


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
        return install()
    except (ServerError, StorageError, MissingExtraError) as error:
        pytest.skip(f"the real detector cannot be had: {error}")
