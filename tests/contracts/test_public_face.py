"""The names that other people's code relies on, and what importing them costs."""

import subprocess
import sys

import pytest

import eagor


@pytest.mark.parametrize("name", eagor.__all__)
def test_every_public_name_is_there_and_says_what_it_is(name):
    value = getattr(eagor, name)
    assert name in dir(eagor)
    assert isinstance(value, str) or (value.__doc__ or "").strip()


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
