"""Clients of the studio that begin and do not go on: they are let go, and leave nothing behind."""

import asyncio
import contextlib
import logging
import socket
import threading
from types import SimpleNamespace

import pytest
import uvicorn
from PIL import Image
from websockets.sync.client import connect

from eagor.studio import server as web_server
from eagor.studio import uploads
from eagor.studio.guard import Gate
from eagor.studio.hub import Settings, Studio
from eagor.studio.messages import PageError
from eagor.studio.server import create_app

LONG = 120.0  # seconds after which a test gives up


@contextlib.contextmanager
def serving(app, **options):
    """The port at which `app` is served as the studio is, in a thread."""
    server = uvicorn.Server(web_server.configured(app, lifespan="off", log_config=None, **options))
    taken = socket.socket()
    taken.bind(("127.0.0.1", 0))
    taken.listen()
    thread = threading.Thread(target=server.run, kwargs={"sockets": [taken]})
    thread.start()
    try:
        yield taken.getsockname()[1]
    finally:
        server.should_exit = True
        thread.join(LONG)
        taken.close()


def connected(port):
    line = socket.create_connection(("127.0.0.1", port), timeout=LONG)
    return contextlib.closing(line)


async def patient(scope, receive, send):
    """Answers after much longer than a head may take; echoes on a WebSocket."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        await asyncio.sleep(5 * web_server.PATIENCE)
        await send({"type": "websocket.send", "text": "still here"})
        await receive()
        return
    await asyncio.sleep(5 * web_server.PATIENCE)
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"ok"})


HEAD = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"


def answered(line):
    """All that comes until it is closed."""
    found = b""
    while piece := line.recv(1 << 16):
        found += piece
    return found


@pytest.mark.parametrize("begun", [b"", b"GET / HT", HEAD])
def test_a_head_that_does_not_end_is_let_go(monkeypatch, begun):
    monkeypatch.setattr(web_server, "PATIENCE", 0.3)
    with serving(patient) as port, connected(port) as line:
        line.sendall(begun)
        assert answered(line) == b""


def test_a_head_that_trickles_is_let_go(monkeypatch):
    monkeypatch.setattr(web_server, "PATIENCE", 0.3)
    with serving(patient) as port, connected(port) as line:
        line.settimeout(0.05)
        line.sendall(HEAD)
        for _ in range(2000):
            try:
                line.sendall(b"X: 1\r\n")
                if line.recv(1) == b"":
                    return
            except TimeoutError:
                continue
            except OSError:
                return
    pytest.fail("it is still read")


def test_a_slow_answer_and_a_second_request_are_not_cut(monkeypatch):
    monkeypatch.setattr(web_server, "PATIENCE", 0.3)
    with serving(patient, timeout_keep_alive=60) as port, connected(port) as line:
        for _ in range(2):
            line.sendall(HEAD + b"\r\n")
            found = b""
            while not found.endswith(b"ok"):
                found += line.recv(1 << 16)
            assert found.startswith(b"HTTP/1.1 200")
        line.sendall(HEAD)  # the next one, half of it
        assert b"200" not in answered(line)


def test_a_websocket_stays(monkeypatch):
    monkeypatch.setattr(web_server, "PATIENCE", 0.3)
    with serving(patient) as port, connect(f"ws://127.0.0.1:{port}/", open_timeout=LONG) as line:
        assert line.recv(timeout=LONG) == "still here"


async def silent():
    yield b"x" * 100
    await asyncio.Event().wait()


async def trickling():
    while True:
        yield b"x"
        await asyncio.sleep(0.001)


@pytest.mark.parametrize("chunks", [silent, trickling])
def test_an_upload_that_is_too_slow_is_given_up(monkeypatch, chunks):
    monkeypatch.setattr(uploads, "PATIENCE", 0.2)
    monkeypatch.setattr(uploads, "SLOWEST", 1 << 30)
    kept = uploads.Uploads()
    with pytest.raises(PageError, match=r"The file comes too slowly: \d+ bytes in") as caught:
        asyncio.run(kept.receive(None, chunks()))
    assert caught.value.status == 408
    assert kept._folder is not None
    assert list(kept._folder.iterdir()) == []
    kept.close()


def test_an_upload_that_is_fast_enough_may_take_long():
    async def steady():
        for _ in range(50):
            yield bytes(1 << 16)

    kept = uploads.Uploads()
    assert asyncio.run(kept.receive(None, steady())).stat().st_size == 50 << 16
    kept.close()


async def once(size):
    yield bytes(size)


@pytest.mark.parametrize(("declared", "sent"), [(300, 1), (None, 300)])
def test_an_upload_beyond_the_bound_is_refused_with_the_bound(monkeypatch, declared, sent):
    monkeypatch.setattr(uploads, "BYTES", 200)
    kept = uploads.Uploads()
    with pytest.raises(PageError, match="larger than 0 MB") as caught:
        asyncio.run(kept.receive(declared, once(sent)))
    assert caught.value.status == 413
    assert "eagor studio --source FILE" in caught.value.change
    kept.close()


def test_an_upload_that_the_disk_has_no_room_for_is_refused_before_it_comes(monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=5 << 20))
    kept = uploads.Uploads()
    with pytest.raises(PageError, match="The file has 9 MB, and 5 MB are free") as caught:
        asyncio.run(kept.receive(9 << 20, once(1)))
    assert caught.value.status == 507
    kept.close()


def test_circles_of_fisheyes_are_refused_with_the_way_to_watch_them(monkeypatch, tmp_path):
    monkeypatch.setattr("eagor.media.defects.fisheye_circles", lambda picture: 2)
    Image.new("RGB", (256, 128)).save(tmp_path / "x3.png")
    with pytest.raises(PageError, match="shows the circles of a fisheye camera") as caught:
        uploads.Uploads().keep(tmp_path / "x3.png", "x3.png")
    assert "eagor studio --source FILE --rig LENSES.yaml" in caught.value.change


def test_who_goes_in_the_middle_of_an_upload_leaves_no_trace(caplog):
    studio = Studio(Settings(Gate("127.0.0.1", None)))
    with caplog.at_level(logging.WARNING), serving(create_app(studio)) as port:
        with connected(port) as line:
            line.sendall(b"POST /api/pictures HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000000\r\n\r\nabc")
            for _ in range(10_000):  # until it is being received
                if studio.uploads._folder is not None and list(studio.uploads._folder.iterdir()):
                    break
                threading.Event().wait(0.01)
        for _ in range(10_000):
            if not list(studio.uploads._folder.iterdir()):
                break
            threading.Event().wait(0.01)
        assert list(studio.uploads._folder.iterdir()) == []
    studio.uploads.close()
    assert [record.getMessage() for record in caplog.records if record.name.startswith("uvicorn")] == []
