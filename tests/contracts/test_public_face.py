"""The names that other people's code relies on, and what importing them costs."""

import doctest
import math
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import eagor

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src"
PACKAGES = sorted(".".join(path.parent.relative_to(SOURCE).parts) for path in SOURCE.glob("eagor/**/__init__.py"))
PUBLIC = sorted({f"eagor.{module}" for module in (*eagor._MODULES, *eagor._HOME)} - {*PACKAGES})


@pytest.mark.parametrize("name", eagor.__all__)
def test_every_public_name_is_there_and_says_what_it_is(name):
    value = getattr(eagor, name)
    assert name in dir(eagor)
    assert isinstance(value, str) or (value.__doc__ or "").strip()


@pytest.mark.parametrize("name", [name for name in eagor.__all__ if ">>>" in (getattr(eagor, name).__doc__ or "")])
def test_the_example_of_a_public_name_gives_what_it_shows(name):
    names = {"eagor": eagor, "math": math, "np": np}
    example = doctest.DocTestParser().get_doctest(getattr(eagor, name).__doc__, names, name, None, None)
    runner = doctest.DocTestRunner()
    told = []
    runner.run(example, out=told.append)
    assert not runner.summarize(verbose=False).failed, "".join(told)


@pytest.mark.parametrize("module", [*PACKAGES, *PUBLIC])
def test_every_package_and_every_public_module_lists_its_names(module):
    loaded = import_module(module)
    assert len(set(loaded.__all__)) == len(loaded.__all__)
    assert not [name for name in loaded.__all__ if not hasattr(loaded, name)]


def test_dir_shows_the_documented_names_and_modules_and_nothing_else():
    """Whatever was imported before."""
    page = (ROOT / "docs" / "api" / "index.md").read_text(encoding="utf-8")
    names = re.findall(r"\[`(\w+)`\]\(\w+\.md#eagor\.", page.partition("\n## ")[0])
    pages = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "api").glob("*.md"))
    assert dir(eagor) == sorted([*names, *eagor._MODULES, "__version__"])
    assert {*eagor._MODULES} <= {*re.findall(r"^::: eagor\.(\w+)$", pages, re.MULTILINE)}


def test_a_documented_module_is_there_after_import_eagor():
    code = "import eagor; print(*(getattr(eagor, module).__name__ for module in eagor._MODULES))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert loaded == [f"eagor.{module}" for module in eagor._MODULES]


def test_the_model_of_a_detector_and_of_motion_are_public():
    assert {"DetectorModel", "MotionModel"} <= set(eagor.__all__)
    assert not hasattr(eagor.Calibration, "detector")
    assert not hasattr(eagor.DirectionTracker, "belief")


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="Beleif"):
        _ = eagor.Beleif


def test_importing_loads_nothing_heavy():
    """Neither the package nor its core may pull in drawing, models or the command line."""
    code = "import sys, eagor; eagor.DirectionTracker(); print(' '.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    heavy = {"matplotlib", "PIL", "torch", "onnxruntime", "embreex", "trimesh", "gymnasium", "tyro", "rich"}
    assert not (heavy | {"scipy.optimize"}) & set(loaded)
    code = "import sys, eagor; print(' '.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "numpy" not in loaded, "the command line sets the number of threads first"
