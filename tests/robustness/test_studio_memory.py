"""The process that sees keeps apartments and photographs while a page uses them, and gives them back afterwards."""

import gc
import weakref

import numpy as np
import pytest
from PIL import Image

from eagor.studio import eye
from eagor.studio.session import Built, Close, Opened, Question, See


@pytest.fixture
def seeing(monkeypatch):
    """Opens and closes views as the process is told to; `said` is what it says."""
    said, used, reels = [], {}, {}

    class Seeing:
        def open(self, what, session, which):
            used[session] = which
            eye._build((what, session, which, *[None] * (what == "picture")), said.append)  # None: the whole sphere
            assert isinstance(said[-1], Built | Opened), said[-1]
            return said[-1]

        def tell(self, job):
            eye._serve(job, reels, used, said.append)

    monkeypatch.setattr(eye, "SPARE", 0)
    eye._leave(())
    yield Seeing()
    eye._leave(())


@pytest.mark.slow
def test_apartments_go_with_the_last_page_that_shows_them(seeing):
    gone = []
    for session, seed in enumerate([3, 3, 8]):
        assert seeing.open("house", session, seed).house.seed == seed
        gone.append(weakref.ref(eye._homes(seed).place))
    assert gone[0]() is gone[1]() is not None
    seeing.tell(Close(0))
    seeing.tell(Close(2))
    assert gone[2]() is None
    assert gone[1]() is not None  # another page is still in it
    seeing.tell(See(1, 0.0, np.eye(3), eye._eye(eye._homes(3)), Question("chair", "truth"), 0, 3))
    seeing.tell(Close(1))
    gc.collect()
    assert gone[1]() is None
    assert eye._homes.bytes == 0


def test_photographs_go_with_their_page_and_are_bounded_before(seeing, tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    files = [tmp_path / f"{number}.png" for number in range(4)]
    for file in files:
        Image.fromarray(rng.integers(0, 255, (128, 256, 3), dtype=np.uint8)).save(file)
    one = 3 * 128 * 256
    monkeypatch.setattr(eye._photograph, "most", 2 * one + 50_000)
    for session, file in enumerate(files):
        assert seeing.open("picture", session, file).jpeg
        assert eye._photograph.bytes <= eye._photograph.most
    for session in range(4):  # those that had no room are read again
        seeing.tell(See(session, 0.0, np.eye(3), None, Question("red chair", "colour"), 0, None, files[session]))
    for session in range(4):
        seeing.tell(Close(session))
    assert eye._photograph.bytes == 0
