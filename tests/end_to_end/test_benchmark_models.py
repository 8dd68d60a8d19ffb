"""Benchmarks with published data, played by models: local ones that talk, servers, and servers that are not there."""

import json
import socket

import hstar_data
import osr_data
import pytest
import transformers
import vlm_models
from contract_server import ContractServer, Reply

from eagor.cli import main
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


@pytest.fixture
def eagor(capsys):
    """Runs a command in this process: exit code, stdout, stderr."""

    def run(*words):
        code = main([str(word) for word in words])
        out, err = capsys.readouterr()
        return code, out, err

    return run


@pytest.fixture(scope="module")
def nobody():
    """An address at which no server is."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{free.getsockname()[1]}/v1?retries=0&backoff=0&timeout=5"


def words(task, data, out, *more):
    return ("bench", "run", task, "--data", data[task], "--limit", 2, "--out", out, *SMALL[task], "--json", *more)


@pytest.mark.parametrize("task", SMALL)
def test_a_local_model_plays(eagor, data, model, tmp_path, monkeypatch, task):
    loads, really = [], loading.load_model
    monkeypatch.setattr(loading, "load_model", lambda name, **rest: loads.append(name) or really(name, **rest))
    code, out, err = eagor(*words(task, data, tmp_path / "run", "--agent", "vlm", "--model", model))
    assert code == 0, err
    assert (json.loads(out)["episodes"], json.loads(out)["model"]) == (2, model)
    assert loads == [model.partition("?")[0]]  # once, from the check to the last case
    assert shared_chat.cache_info().currsize == 0  # and let go of
    found = log.read(tmp_path / "run")
    if task == "osr":
        assert [record["skill"] for record in found] == ["cognitive_map", "object_counting"]
        assert "map" in found[1]["steps"][0]
    else:
        assert all(record["views"] == 10 and record["cause"] == "format" for record in found)  # it talks nonsense
        assert all(step["tokens"][0] > 100 for record in found for step in record["steps"])


@pytest.mark.slow
def test_a_local_model_plays_on_two_processes(eagor, data, model, tmp_path):
    code, out, err = eagor(*words("osr", data, tmp_path / "run", "--agent", "vlm", "--model", model, "--workers", 2))
    assert code == 0, err
    assert (json.loads(out)["episodes"], json.loads(out)["failed"]) == (2, 0)


@pytest.mark.parametrize("task", SMALL)
@pytest.mark.parametrize("who", ["perception", "model"])
def test_a_server_that_is_not_there_is_told_before_the_run(eagor, data, nobody, tmp_path, task, who):
    agent = {"perception": ("--agent", "eagor", "--perception", f"endpoint:qwen2.5-vl@{nobody}"),
             "model": ("--agent", "vlm", "--model", f"qwen2.5-vl@{nobody}")}[who]  # fmt: skip
    code, out, err = eagor(*words(task, data, tmp_path / "run", *agent))
    assert (code, out) == (1, "")
    assert "no server answers at" in err.splitlines()[-1]
    assert not (tmp_path / "run").exists()
    assert shared.cache_info().currsize == shared_chat.cache_info().currsize == 0


def test_a_server_is_asked_once_before_the_run_and_shared_by_all_workers(eagor, data, tmp_path):
    with ContractServer(lambda request: Reply("<answer>submit(55,0)</answer>"), ("qwen2.5-vl-7b",)) as server:
        agent = ("--agent", "vlm", "--model", f"@{server.url}", "--engine", "threads", "--workers", 4)
        code, out, err = eagor(*words("hstar-hos", data, tmp_path / "run", *agent))
        asked = [request.body["max_tokens"] for request in server.requests]
    assert code == 0, err
    assert asked == [1, 512, 512]  # the check, then a turn of each case
    assert json.loads(out)["views"] == 1.0


def test_a_model_that_the_server_lacks_and_models_that_cannot_talk(eagor, data, tmp_path):
    with ContractServer(lambda request: "hello", ("llava",)) as server:
        server.lasting = "404 model"
        spec = f"qwen@{server.url}?retries=0"
        code, _, err = eagor(*words("hstar-hos", data, tmp_path / "run", "--agent", "vlm", "--model", spec))
    assert code == 2
    assert "has no model 'qwen'" in err.splitlines()[-1]
    localiser = vlm_models.make("owlv2", tmp_path / "owl")
    for spec, says in (
        (localiser, "locates things and cannot talk"),
        (tmp_path / "nowhere", "there is no folder"),
        (f"qwen@{server.url}?colour=red", "a served model has no option colour; it has the options model, servers"),
    ):
        code, out, err = eagor(*words("osr", data, tmp_path / "run", "--agent", "vlm", "--model", spec))
        assert (code, out) == (2, "")
        assert says in err.splitlines()[-1]
    assert not (tmp_path / "run").exists()
