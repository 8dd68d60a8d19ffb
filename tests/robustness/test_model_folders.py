"""A folder with a model is data: no code in it is run, and no pickle is opened.

What a library prints while a model is loaded does not reach stdout, which is for results.
"""

import json
import shutil
from contextlib import suppress

import pytest
import torch
import transformers
from vlm_models import make

from eagor.errors import EagorError
from eagor.perception import load

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return make("qwen2_5_vl", tmp_path_factory.mktemp("models") / "qwen2_5_vl")


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "model")


def test_pickled_weights_are_not_opened(folder, tmp_path):
    opened = tmp_path / "opened"

    class Bomb:
        def __reduce__(self):
            return (open, (str(opened), "w"))

    (folder / "model.safetensors").unlink()
    torch.save({"weight": Bomb()}, folder / "pytorch_model.bin")
    with pytest.raises(EagorError, match=r"cannot be loaded \(AutoModelForImageTextToText: OSError: .*safetensors"):
        load(str(folder))
    assert not opened.exists()


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        ("config.json", "AutoConfig"),
        ("config.json", "AutoModelForImageTextToText"),
        ("tokenizer_config.json", "AutoTokenizer"),
        ("preprocessor_config.json", "AutoImageProcessor"),
    ],
)
def test_code_in_the_folder_is_not_run_nor_asked_for(folder, tmp_path, capsys, monkeypatch, file, kind):
    ran = tmp_path / "ran"
    (folder / "theirs.py").write_text(f"open({str(ran)!r}, 'w')\n")
    told = json.loads((folder / file).read_text())
    named = "theirs.Theirs"
    told["auto_map"] = {kind: [named, named] if kind == "AutoTokenizer" else named}
    (folder / file).write_text(json.dumps(told))
    monkeypatch.setattr("builtins.input", lambda *_: pytest.fail("it asks"))
    with suppress(EagorError):  # some kinds are of the library itself as well, and are then loaded from there
        load(str(folder))
    assert not ran.exists()
    assert capsys.readouterr().out == ""


def test_what_a_library_prints_is_no_result(folder, capsys, monkeypatch):
    read = transformers.AutoConfig.from_pretrained

    def talkative(*arguments, **options):
        print("Do you wish to run the custom code? [y/N]")
        return read(*arguments, **options)

    monkeypatch.setattr(transformers.AutoConfig, "from_pretrained", talkative)
    load(str(folder))
    out, err = capsys.readouterr()
    assert out == ""
    assert "custom code" in err
