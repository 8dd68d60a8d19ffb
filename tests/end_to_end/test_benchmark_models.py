"""Benchmarks with published data, played by models: local ones that talk, servers, and servers that are not there."""

import socket

import hstar_data
import osr_data
import pytest
import transformers
import vlm_models
from commands import answer, refused
from contract_server import ContractServer, Reply

from eagor.lab.agents.models import shared, shared_chat
from eagor.lab.eval import log
from eagor.perception.transformers import loading

pytestmark = pytest.mark.usefixtures("one_thread")
SMALL = {"hstar-hos": ("--set", "resolution=36"), "osr": ("--set", "suffix=qa")}  # osr with the map: two turns


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A tiny random model, and how it is named."""
    transformers.utils.logging.disable_progress_bar()
    return f"{vlm_models.make('qwen2_5_vl', tmp_path_factory.mktemp('models') / 'tiny')}?pixels=25088&max_tokens=4"


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
def test_a_local_model_plays(data, model, tmp_path, monkeypatch, task):
    loads, really = [], loading.load_model
    monkeypatch.setattr(loading, "load_model", lambda name, **rest: loads.append(name) or really(name, **rest))
    said = answer(*words(task, data, tmp_path / "run", "--agent", "vlm", "--model", model))
    assert (said["episodes"], said["model"]) == (2, model)
    assert loads == [model.partition("?")[0]]  # once, from the check to the last case
    assert shared_chat.cache_info().currsize == 0  # and let go of
    found = log.read(tmp_path / "run")
    if task == "osr":
        assert [record["skill"] for record in found] == ["cognitive_map", "object_counting"]
        assert "map" in found[1]["steps"][0]
    else:
        assert all(record["views"] == 10 and record["cause"] == "format" for record in found)  # it talks nonsense
        assert all(step["tokens"][0] > 100 for record in found for step in record["steps"])


@pytest.mark.parametrize("task", SMALL)
@pytest.mark.parametrize("who", ["perception", "model"])
def test_a_server_that_is_not_there_is_told_before_the_run(data, nobody, tmp_path, task, who):
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
    localiser = vlm_models.make("owlv2", tmp_path / "owl")
    for spec, says in (
        (localiser, "locates things and cannot talk"),
        (tmp_path / "nowhere", "there is no folder"),
        (f"qwen@{server.url}?colour=red", "a served model has no option colour; it has the options model, servers"),
    ):
        assert says in refused(*words("osr", data, tmp_path / "run", "--agent", "vlm", "--model", spec))
    assert not (tmp_path / "run").exists()
