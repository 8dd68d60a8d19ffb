"""A server can neither hold us for ever nor fill the memory, and it learns and leaves behind no more than it has to.

- Every answer is whole within its deadline, or given up: a byte now and then, headers without end, silence.
- It is given up beyond so many bytes, and unpacked never.
- What it says is read in time that grows with its length alone.
- Keys and passwords are written nowhere, also where the server sends them back; a redirect is told, not followed.
- Ctrl-C ends a call at once, whatever the server does.
"""

from __future__ import annotations

import gzip
import itertools
import json
import os
import pickle
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import pytest
from contract_server import ContractServer, reddish
from PIL import Image

from eagor.cli import main, terminal
from eagor.errors import AnswerError, EagorError, ServerError
from eagor.lab.eval import log
from eagor.perception import load, place_of, short_name
from eagor.perception.endpoint import EndpointPerception, ServedChat
from eagor.perception.vlm import Message
from eagor.perception.vlm.answers import parse_boxes, parse_presence

pytest.importorskip("openai")

GREY = np.full((56, 112, 3), 128, dtype=np.uint8)


def look(url, **options):
    options = {"pixels": 56 * 112, "seam": False, "retries": 0, "timeout": 20.0} | options
    return EndpointPerception("m", url, **options)(GREY, "red chair")


# --- a server that does what it likes ---

OK = b"HTTP/1.1 200 OK\r\ncontent-type: application/json\r\n"


def whole(body: bytes, head: bytes = OK) -> bytes:
    """A complete answer with this body."""
    return head + b"content-length: %d\r\nconnection: close\r\n\r\n" % len(body) + body


def completion(text: str) -> bytes:
    """A complete answer that says `text`."""
    message = {"role": "assistant", "content": text}
    choice = {"index": 0, "message": message, "finish_reason": "stop", "logprobs": None}
    body = {"id": "x", "object": "chat.completion", "created": 0, "model": "m", "choices": [choice], "usage": None}
    return whole(json.dumps(body).encode())


class HostileServer:
    """Does to each request whatever a function does with the open connection, on a free port of this machine.

    `answer(connection, request, gone)` gets the socket, the bytes of the request, and an event that is set at the end.
    `requests` holds what came.
    """

    def __init__(
        self,
        answer: Callable[[socket.socket, bytes, threading.Event], None],
        secured: ssl.SSLContext | None = None,
    ) -> None:
        self._answer, self._secured = answer, secured
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._gone = threading.Event()
        self.requests: list[bytes] = []
        self.url = f"http{'s' if secured else ''}://localhost:{self._listening.getsockname()[1]}/v1"

    def __enter__(self) -> HostileServer:
        threading.Thread(target=self._serve, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._gone.set()
        self._listening.close()

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                threading.Thread(target=self._one, args=(connection,), daemon=True).start()

    def _one(self, connection: socket.socket) -> None:
        with suppress(OSError), connection:
            if self._secured:
                connection = self._secured.wrap_socket(connection, server_side=True)
            with connection:
                request = _request(connection)
                if request:
                    self.requests.append(request)
                    self._answer(connection, request, self._gone)


def _request(connection: socket.socket) -> bytes:
    """A whole request."""
    data = b""
    while b"\r\n\r\n" not in data:
        part = connection.recv(1 << 16)
        if not part:
            return b""
        data += part
    head, _, body = data.partition(b"\r\n\r\n")
    lengths = [line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")]
    wanted = int(lengths[0].partition(b":")[2]) if lengths else 0
    while len(body) < wanted:
        body += connection.recv(1 << 16)
    return head + b"\r\n\r\n" + body


# --- time and memory -------------------------------------------------------------------------------------------------


def trickling(head, piece):
    def answer(connection, _, gone):
        connection.sendall(head)
        for _ in itertools.count():
            connection.sendall(piece)
            if gone.wait(0.05):
                return

    return answer


@pytest.mark.parametrize(
    "answer",
    [
        trickling(OK + b"content-length: 1000000\r\n\r\n", b" "),
        trickling(OK + b"transfer-encoding: chunked\r\n\r\n", b"1\r\n \r\n"),
        trickling(OK, b"x: y\r\n"),
        trickling(b"", b"H"),
        lambda connection, _, gone: gone.wait(),
    ],
    ids=["body", "chunks", "headers", "status", "silence"],
)
def test_an_answer_is_whole_within_its_deadline(answer):
    with HostileServer(answer) as server:
        began = time.monotonic()
        with pytest.raises(ServerError, match=r"gave no answer within 0\.5 s \(tried once\)"):
            look(server.url, timeout=0.5)
        with pytest.raises(ServerError, match=r"gave no answer within 0\.5 s"):
            EndpointPerception("", server.url, timeout=0.5)(GREY, "red chair")  # the list of its models
        assert time.monotonic() - began < 120, "for ever"


def flooding(head):
    def answer(connection, _, gone):
        connection.sendall(head)
        while not gone.is_set():
            connection.sendall(b"x" * (1 << 20))

    return answer


@pytest.mark.parametrize("status", [b"200 OK", b"500 No", b"401 No"])
def test_an_answer_beyond_all_measure_is_given_up(status):
    with HostileServer(flooding(b"HTTP/1.1 " + status + b"\r\ncontent-length: 10000000000\r\n\r\n")) as server:
        with pytest.raises(ServerError, match="sent more than 32 MiB for one answer"):
            look(server.url, retries=3)
        assert len(server.requests) == 1


def test_nothing_is_unpacked():
    packed = gzip.compress(b" " * (64 << 20))
    with HostileServer(
        lambda connection, *_: connection.sendall(whole(packed, OK + b"content-encoding: gzip\r\n"))
    ) as server:
        with pytest.raises(ServerError, match="other than a chat completion"):
            look(server.url)
        assert b"accept-encoding: identity" in server.requests[0].lower()


LONG = 300_000
ANSWERS = {
    "a key again and again": '{"a":1,' * (LONG // 7) + "}",
    "the same key": "{" + '"a":1,' * (LONG // 6),
    "opened": "[" * LONG,
    "words": "no " + "a " * (LONG // 2),
    "negations": "no a " * (LONG // 5),
    "thoughts": "<think>" * (LONG // 7),
}


@pytest.mark.parametrize("text", ANSWERS.values(), ids=ANSWERS)
def test_long_answers_are_refused_before_they_are_read(text):
    for read in (lambda: parse_boxes(text, "thousand", (100, 200)), lambda: parse_presence(text)):
        with pytest.raises(AnswerError, match="the model answered"):
            read()


@pytest.mark.parametrize("text", ['{"a":1,', '"a":[1,2,3,4],', "no a "])
def test_steps_grow_with_the_length_alone(text):
    def steps(count):
        counted = 0

        def count_one(frame, event, argument):
            nonlocal counted
            counted += event == "line"
            return count_one

        body = ("{" if text.startswith('"') else "") + text * count
        before = sys.gettrace()
        sys.settrace(count_one)
        try:
            parse_boxes(body, "thousand", (100, 200))
        except AnswerError:
            pass
        finally:
            sys.settrace(before)
        return counted

    assert steps(2000) < 2.5 * steps(1000)


@pytest.mark.skipif(not hasattr(signal, "SIGINT") or os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize("how", ["look", "chat"])
def test_ctrl_c_ends_a_silent_call(how):
    asked = {
        "look": "EndpointPerception('m', sys.argv[1], pixels=6272)(np.zeros((56, 112, 3), np.uint8), 'chair')",
        "chat": "ServedChat('m', sys.argv[1])([Message('user', 'hello')])",
    }
    code = (
        "import sys, numpy as np\n"
        "from eagor.perception.endpoint import EndpointPerception, ServedChat\n"
        "from eagor.perception.vlm import Message\n"
        f"try:\n    {asked[how]}\nexcept KeyboardInterrupt:\n    sys.exit(130)\n"
    )
    came = threading.Event()

    def answer(_, __, gone):
        came.set()
        gone.wait()

    with HostileServer(answer) as server:
        process = subprocess.Popen([sys.executable, "-c", code, server.url])
        try:
            assert came.wait(120)
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 130, "it waits for the server, which never answers"
        finally:
            process.kill()
            process.wait()


# --- secrets ---------------------------------------------------------------------------------------------------------

SECRET = "sk-live-7c2e91f0"


def echoing(status):
    """Sends back all that it was told."""

    def answer(connection, request, _):
        head = request.partition(b"\r\n\r\n")[0].decode("latin-1")
        said = "\n".join(sorted(head.splitlines(), key=lambda line: "uthorization" not in line))
        head = b"HTTP/1.1 " + status + b"\r\ncontent-type: application/json\r\n"
        connection.sendall(whole(json.dumps({"error": {"message": said}}).encode(), head))

    return answer


@pytest.mark.parametrize("status", [b"401 No", b"400 No", b"500 No", b"404 No"])
def test_a_key_that_is_sent_back_is_not_shown(status, monkeypatch):
    monkeypatch.setenv("HOUSE_KEY", SECRET)
    with HostileServer(echoing(status)) as server:
        with pytest.raises(ServerError) as caught:
            look(server.url, key="HOUSE_KEY")
        assert SECRET.encode() in server.requests[0]
        chain, error = "", caught.value
        while error is not None:
            chain += f"{error!r} {error} {getattr(error, 'body', '')}"
            error = error.__cause__ or error.__context__
        assert "***" in str(caught.value)
        assert SECRET not in chain


EVIL = "\x1b]0;owned\x07\x1b[2J\x9b31m\rall is well\u202e"


def test_what_a_server_says_does_not_steer_the_terminal(tmp_path, capsys):
    """Neither in the error's line nor in the traceback, nor as a step of JSON."""
    Image.fromarray(GREY).save(tmp_path / "p.png")

    def answer(connection, *_):
        head = b"HTTP/1.1 400 No\r\ncontent-type: application/json\r\n"
        connection.sendall(whole(json.dumps({"error": {"message": f"no such {EVIL} model"}}).encode(), head))

    with HostileServer(answer) as server:
        address = f"endpoint:m@{server.url}?retries=0"
        assert main(["locate", str(tmp_path / "p.png"), "red chair", "--perception", address, "--debug"]) > 0
    out, err = capsys.readouterr()
    assert "no such" in err
    assert "owned" in err
    assert [each for each in out + err if not each.isprintable() and each not in "\n\t"] == []


def test_results_do_not_steer_the_terminal_either(capsys):
    terminal.emit({"words": EVIL, "further": {EVIL: [EVIL]}})
    said = capsys.readouterr().out
    assert said.rstrip("\n").isprintable()
    assert json.loads(said) == {"words": EVIL, "further": {EVIL: [EVIL]}}
    terminal.facts({"name": EVIL, EVIL: {"inner": [EVIL, "b"]}})
    terminal.say(EVIL, "two\tcolumns")
    terminal.warning(EVIL)
    out, err = capsys.readouterr()
    assert "two\tcolumns" in out
    assert [each for each in out + err if not each.isprintable() and each not in "\n\t"] == []


def test_an_answer_holds_no_key_either(monkeypatch):
    monkeypatch.setenv("HOUSE_KEY", SECRET)
    with HostileServer(lambda connection, *_: connection.sendall(completion(f"my key is {SECRET}"))) as server:
        said = ServedChat("m", server.url, key="HOUSE_KEY")([Message("user", "hello")])
    assert said.text == "my key is ***"


def test_a_password_in_an_address_is_used_and_not_shown(tmp_path):
    with ContractServer(reddish) as server:
        host = server.url.removeprefix("http://")
        perception = EndpointPerception("qwen", f"http://anna:hunter2-0815@{host}", pixels=56 * 112, seam=False)
        evidence = perception(GREY, "red chair")
        assert server.requests[0].headers["authorization"] == "Basic YW5uYTpodW50ZXIyLTA4MTU="
    told = json.dumps(dict(evidence.source or {})) + repr(perception)
    assert f"http://***@{host}" in told
    with log.Log(tmp_path / "run") as book:
        book.begin({"perception": f"endpoint:qwen@http://anna:hunter2-0815@{host}"})
    with log.Log(tmp_path / "run") as kept:
        kept.append({"key": "a", "attempt": 1, "status": "failed", "error": "hunter2-0815"})
    with log.Log(tmp_path / "run") as book:
        book.begin({"perception": f"endpoint:qwen@http://anna:hunter2-0815@{host}"})  # the same run
    told += "".join(path.read_text() for path in (tmp_path / "run").iterdir())
    for secret in ("hunter2-0815", "YW5uYTpodW50ZXIyLTA4MTU="):
        assert secret not in told
    assert pickle.loads(pickle.dumps(perception)).client.address == perception.client.address


def test_an_address_with_a_password_is_taken_apart():
    assert place_of("m@http://u:p@h/v1") == ("m", "http://u:p@h/v1")
    assert place_of("org/m@gpu:8000") == ("org/m", "gpu:8000")
    assert short_name("endpoint:org/m@http://u:p@h/v1") == "endpoint-m"
    with pytest.raises(EagorError) as caught:
        load("endpoint:m@ftp://u:hunter2-0815@h")
    assert "hunter2-0815" not in str(caught.value)
    with pytest.raises(EagorError) as caught:
        load("endpoint:m@http://u:hunter2-0815@:0")
    assert "hunter2-0815" not in str(caught.value)


def test_a_key_that_was_typed_instead_of_its_name_is_not_repeated(capsys):
    code = main(["locate", "nowhere.png", "chair", "--perception", f"endpoint:m@http://localhost:9?key={SECRET}"])
    assert code == 2
    with pytest.raises(EagorError, match=r"that key=\.\.\. names") as caught:
        look("http://localhost:9", key=SECRET)
    assert SECRET not in str(caught.value) + capsys.readouterr().err


def test_what_is_meant_for_openai_goes_nowhere_else(monkeypatch):
    for name in ("OPENAI_API_KEY", "OPENAI_ADMIN_KEY", "OPENAI_ORG_ID", "OPENAI_PROJECT_ID", "OPENAI_WEBHOOK_SECRET"):
        monkeypatch.setenv(name, f"private-{name}")
    monkeypatch.setenv("OPENAI_CUSTOM_HEADERS", "X-Team: private-team\nAuthorization: Bearer private-bearer")
    with HostileServer(lambda connection, *_: connection.sendall(completion("[]"))) as server:
        look(server.url)
        assert b"private" not in server.requests[0]
        assert b"authorization: bearer none" in server.requests[0].lower()


@pytest.mark.parametrize("status", [b"301 Moved", b"302 Found", b"303 Other", b"307 Later", b"308 Moved"])
def test_a_redirect_is_told_and_not_followed(status, monkeypatch):
    monkeypatch.setenv("HOUSE_KEY", SECRET)
    with HostileServer(lambda connection, *_: connection.sendall(completion("[]"))) as elsewhere:
        place = f"location: {elsewhere.url}/chat/completions?who={SECRET}\r\n".encode()
        head = b"HTTP/1.1 " + status + b"\r\n" + place
        with (
            HostileServer(lambda connection, *_: connection.sendall(whole(b"", head))) as server,
            pytest.raises(ServerError, match=f"It redirects to {elsewhere.url}") as caught,
        ):
            look(server.url, key="HOUSE_KEY")
        assert elsewhere.requests == []
        assert SECRET not in str(caught.value)


# --- certificates ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """A certificate for localhost that nobody else vouches for, and its key, as files."""
    folder = tmp_path_factory.mktemp("certificate")
    made = subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost",
         "-addext", "subjectAltName=DNS:localhost", "-keyout", "key.pem", "-out", "cert.pem"],
        cwd=folder, capture_output=True, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    return folder / "cert.pem", folder / "key.pem"


def test_a_certificate_of_ones_own_counts_for_this_machine_too(certificate, monkeypatch, tmp_path):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*certificate)
    monkeypatch.delenv("SSL_CERT_FILE", raising=False)
    with HostileServer(lambda connection, *_: connection.sendall(completion("[]")), context) as server:
        with pytest.raises(ServerError, match=r"no server answers.*CERTIFICATE_VERIFY_FAILED"):
            look(server.url)
        assert look(server.url, ca=str(certificate[0])).source is not None
        assert load(f"endpoint:m@{server.url}?ca={certificate[0]}&pixels=6272&seam=false")(GREY, "chair").source
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))
        assert look(server.url).source is not None
        (tmp_path / "none.pem").write_text("nothing")
        with pytest.raises(EagorError, match=r"ca is .*none\.pem, where no certificates can be read"):
            look(server.url, ca=str(tmp_path / "none.pem"))
