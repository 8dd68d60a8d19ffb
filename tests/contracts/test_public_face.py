"""The names that other people's code relies on, and what importing them costs."""

import doctest
import math
import subprocess
import sys
from importlib import import_module
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

import eagor

SOURCE = Path(eagor.__file__).parents[1]
PACKAGES = sorted(".".join(path.parent.relative_to(SOURCE).parts) for path in SOURCE.glob("eagor/**/__init__.py"))
# The face as the design promises it: neither a name nor its place may change.
FACE = """
ErpGrid.directions ErpGrid.weights PatchGrid.directions PerspectiveGrid.directions angular_distance log_ranges
RealHarmonics.size RealHarmonics.evaluate RealHarmonics.analyse RealHarmonics.synthesise RealHarmonics.rotate
Calibration.paper DetectorModel MotionModel Evidence.coefficients Evidence.from_response Evidence.from_boxes
Evidence.from_mask Evidence.from_points Belief.uniform Belief.predict Belief.update Belief.log_density Belief.mode
Belief.modes Belief.mean_direction Belief.resultant Belief.credible_region Belief.entropy Belief.diffuse Belief.forget
Belief.presence RangedBelief.uniform RangedBelief.predict RangedBelief.update RangedBelief.mode RangedBelief.distance
RangedBelief.direction_belief TrackerConfig.paper DirectionTracker.add_pose DirectionTracker.observe
DirectionTracker.estimate Estimate.direction Estimate.azimuth Estimate.elevation Estimate.modes
Estimate.credible_angle Estimate.presence Estimate.distance Estimate.status Estimate.density Estimate.log_density
Estimate.within Estimate.as_dict Detector.from_ultralytics Detector.from_supervision Detector.from_transformers Loop
load open_source open_poses perception.load perception.coco.DETECTOR sphere.world_R_body
"""


def test_what_the_design_promises_can_be_imported_and_all_that_is_shown_is_there():
    import_module("eagor.perception.coco")
    for name in FACE.split():
        assert name.partition(".")[0] in dir(eagor)
        assert attrgetter(name)(eagor) is not None
    assert eagor.Belief.uniform(1).coefficients.shape == (4,)
    for name in dir(eagor):
        value = getattr(eagor, name)
        assert isinstance(value, str) or (value.__doc__ or "").strip(), f"{name} does not say what it is"


@pytest.mark.parametrize("name", [name for name in eagor.__all__ if ">>>" in (getattr(eagor, name).__doc__ or "")])
def test_the_example_of_a_public_name_gives_what_it_shows(name):
    names = {"eagor": eagor, "math": math, "np": np}
    example = doctest.DocTestParser().get_doctest(getattr(eagor, name).__doc__, names, name, None, None)
    runner = doctest.DocTestRunner()
    told = []
    runner.run(example, out=told.append)
    assert not runner.summarize(verbose=False).failed, "".join(told)


@pytest.mark.parametrize("module", sorted({*PACKAGES, *(f"eagor.{name}" for name in eagor._MODULES)}))
def test_every_package_and_every_public_module_lists_its_names(module):
    loaded = import_module(module)
    assert len(set(loaded.__all__)) == len(loaded.__all__)
    assert not [name for name in loaded.__all__ if not hasattr(loaded, name)]


def loaded_by(code):
    told = [sys.executable, "-c", f"import sys, eagor; {code}; print(' '.join(sys.modules))"]
    return set(subprocess.run(told, capture_output=True, text=True, check=True).stdout.split())


def test_importing_loads_nothing_heavy():
    """Neither the package nor its core may pull in drawing, models or the command line; nor a model that is named."""
    heavy = {"matplotlib", "PIL", "torch", "onnxruntime", "embreex", "trimesh", "gymnasium", "tyro", "rich"}
    assert not (heavy | {"scipy.optimize"}) & loaded_by("eagor.DirectionTracker()")
    assert "numpy" not in loaded_by("pass"), "the command line sets the number of threads first"
    named = "import eagor.perception.transformers as t; t.TransformersPerception; eagor.load('endpoint:m@http://a')"
    assert not {"openai", "httpx", "torch", "transformers"} & loaded_by(named)
