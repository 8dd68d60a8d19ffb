"""Benchmarks with published data, played by models on servers, and by servers that are not there."""

import socket

import hstar_data
import osr_data
import pytest
from commands import answer, refused
from contract_server import ContractServer, Reply

from eagor.lab.agents.models import shared, shared_chat

pytestmark = pytest.mark.usefixtures("one_thread")
SMALL = {"hstar-hos": ("--set", "resolution=36"), "osr": ("--set", "suffix=qa")}  # osr with the map: two turns


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Folders of both benchmarks' data."""
    return {
        "hstar-hos": hstar_data.write(tmp_path_factory.mktemp("hstar")),
        "osr": osr_data.write(tmp_path_factory.mktemp("osr")),
    }


@pytest.fixture(scope="module")
def nobody():
    """An address at which no server is."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{free.getsockname()[1]}/v1?retries=0&backoff=0&timeout=5"


def words(task, data, out, *more):
    return ("bench", "run", task, "--data", data[task], "--limit", 2, "--out", out, *SMALL[task], *more)


@pytest.mark.parametrize("task", SMALL)
@pytest.mark.parametrize("who", ["perception", "model"])
def test_a_server_that_is_not_there_is_told_before_the_run(data, nobody, tmp_path, task, who):
    shared.cache_clear()
    shared_chat.cache_clear()
    agent = {"perception": ("--agent", "eagor", "--perception", f"endpoint:qwen2.5-vl@{nobody}"),
             "model": ("--agent", "vlm", "--model", f"qwen2.5-vl@{nobody}")}[who]  # fmt: skip
    assert "no server answers at" in refused(*words(task, data, tmp_path / "run", *agent), code=1)
    assert not (tmp_path / "run").exists()
    assert shared.cache_info().currsize == shared_chat.cache_info().currsize == 0


def test_a_server_is_asked_once_before_the_run_and_shared_by_all_workers(data, tmp_path):
    with ContractServer(lambda request: Reply("<answer>submit(55,0)</answer>"), ("qwen2.5-vl-7b",)) as server:
        agent = ("--agent", "vlm", "--model", f"@{server.url}", "--engine", "threads", "--workers", 4)
        said = answer(*words("hstar-hos", data, tmp_path / "run", *agent))
        asked = [request.body["max_tokens"] for request in server.requests]
    assert asked == [1, 512, 512]  # the check, then a turn of each case
    assert said["views"] == 1.0


def test_a_model_that_the_server_lacks_and_models_that_cannot_talk(data, tmp_path):
    with ContractServer(lambda request: "hello", ("llava",)) as server:
        server.lasting = "404 model"
        spec = f"qwen@{server.url}?retries=0"
        said = refused(*words("hstar-hos", data, tmp_path / "run", "--agent", "vlm", "--model", spec))
    assert "has no model 'qwen'" in said
    for spec, says in (
        (tmp_path, "talks where it is served: `vllm serve"),
        ("Qwen/Qwen2.5-VL-7B-Instruct", "name it as MODEL@http://localhost:8000/v1"),
        (f"qwen@{server.url}?colour=red", "'colour' is no key of a served model"),
    ):
        assert says in refused(*words("osr", data, tmp_path / "run", "--agent", "vlm", "--model", spec))
    assert not (tmp_path / "run").exists()
