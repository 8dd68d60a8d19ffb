"""What one look may and may not say."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import rotations

from eagor.errors import EagorError, ResponseError
from eagor.evidence import Evidence, coverage
from eagor.evidence.averaging import averaged
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.sphere import angular_distance, direction, rotation

PATCHES = PatchGrid(12, 24)
SPHERE = ErpGrid(64, 128)


def field(evidence, degree=15, where=SPHERE):
    return RealHarmonics(degree).synthesise(evidence.coefficients(degree), where)


def brightest(evidence, degree=15):
    values = field(evidence, degree)
    return SPHERE.directions.reshape(-1, 3)[values.argmax()]


@given(st.floats(0, 1), st.floats(0.001, 1), st.floats(0, 1), st.floats(0.1, 4))
def test_the_calibration_is_its_formula(l, floor, neutral, temperature):
    calibration = Calibration(floor, neutral, temperature)
    expected = temperature * math.log((l + floor) / (neutral + floor))
    evidence = Evidence.from_response(np.full(PATCHES.shape, l), PATCHES, calibration)
    assert np.allclose(evidence.log_ratio, expected, atol=1e-12)
    assert np.allclose(calibration.log_ratio(np.array(l)), expected)
    assert np.allclose(evidence.response, l, atol=1e-9 if l > 1e-5 else 1.1e-6), "what is next to nothing is nothing"
    if l == 0:
        assert expected == pytest.approx(calibration.empty)


def test_the_default_says_nothing_at_a_neutral_response_of_at_least_five_per_cent():
    calibration = Calibration()
    assert calibration.neutral >= 0.05
    assert calibration.log_ratio(np.array(calibration.neutral)) == 0
    assert calibration.empty < 0 < calibration.log_ratio(np.array(1.0))


def test_the_published_profile_scales_to_the_maximum_and_only_it_does():
    response = np.random.default_rng(0).random(PATCHES.shape) * 0.4
    paper = Evidence.from_response(response, PATCHES, Calibration.paper())
    assert np.allclose(paper.log_ratio, np.log(response / response.max() + 1e-3), atol=1e-12)
    assert np.allclose(paper.response, response, atol=1e-12)
    ours = Evidence.from_response(response, PATCHES)
    assert np.allclose(ours.log_ratio, Calibration().log_ratio(response))
    assert np.allclose(paper.with_calibration(Calibration()).log_ratio, ours.log_ratio, atol=1e-9)
    for dtype in (np.float32, np.float64):
        for nothing in (0, np.finfo(dtype).smallest_subnormal):
            empty = Evidence.from_response(np.full(PATCHES.shape, nothing, dtype), PATCHES, Calibration.paper())
            assert np.allclose(empty.log_ratio, math.log(1e-3))
        ours = Evidence.from_response(np.zeros(PATCHES.shape, dtype), PATCHES)
        paper = ours.with_calibration(Calibration.paper())
        assert np.allclose(paper.log_ratio, math.log(1e-3)), "the rounding of zero is no response"


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.float16, np.uint8, bool])
def test_an_empty_look_is_good_input_negative_and_bounded(dtype):
    for grid in (PATCHES, PerspectiveGrid(12, 20, 1.5)):
        evidence = Evidence.from_response(np.zeros(grid.shape, dtype), grid)
        assert np.allclose(evidence.log_ratio, Calibration().empty)
    for how, empty in (
        ({"calibration": Calibration()}, Calibration().empty),
        ({"detector": DetectorModel(0.6, 0.2)}, math.log(0.4)),
    ):
        boxes = Evidence.from_boxes([], ErpGrid(256, 512), **how)
        points = Evidence.from_points(np.zeros((0, 3)), 10.0, **how)
        masks = Evidence.from_mask(np.zeros((0, *PATCHES.shape)), PATCHES, **how)
        for evidence in (boxes, points, masks):
            assert np.allclose(field(evidence), empty, atol=1e-5)


VIEWS = [
    PerspectiveGrid(36, 64, math.radians(100), rotation((0, 0, 1), 0.8) @ rotation((0, 1, 0), 0.3)),
    PerspectiveGrid(40, 40, math.radians(60), rotation((1, 2, 0), 1.3)),
    PerspectiveGrid(40, 60, math.radians(140)),
    PerspectiveGrid(108, 192, math.radians(100)),
    FisheyeGrid(40, math.radians(150), rotation((0, 1, 0), -0.6)),
    ErpGrid(36, 72),
    PatchGrid(36, 72),
]


@pytest.mark.parametrize("grid", VIEWS, ids=lambda g: f"{type(g).__name__}-{g.shape}")
@pytest.mark.parametrize("kind", ["empty", "full", "blob", "blob at the border", "one cell", "averaged"])
def test_what_was_not_looked_at_gains_nothing(grid, kind):
    """Beyond 30 degrees outside the border, at L = 15, a view or a masked panorama leaves less than 0.02 nats."""
    height, width = grid.shape
    whole = isinstance(grid, ErpGrid | PatchGrid)
    cover = grid.directions[..., 2] > -0.4 if whole else np.ones(grid.shape, dtype=bool)
    middle, border = (
        grid.directions[height // 2, width // 2],
        grid.unproject(np.array(width * 0.85), np.array(height / 2)),
    )
    cell = np.zeros(grid.shape)
    cell[height // 2, width // 2] = 1
    response = {
        "empty": np.zeros(grid.shape),
        "full": np.ones(grid.shape),
        "blob": np.exp(-0.5 * (angular_distance(grid.directions, middle) / 0.14) ** 2),
        "blob at the border": np.exp(-0.5 * (angular_distance(grid.directions, border) / 0.14) ** 2),
        "one cell": cell,
        "averaged": cell,
    }[kind]
    spread = math.radians(6) if kind == "averaged" else 0.0
    evidence = Evidence.from_response(response, grid, Calibration(spread=spread), coverage=cover)
    assert (evidence.log_ratio[~cover] == 0).all(), "exactly zero where nothing was looked at"
    values = field(evidence)
    seen = grid.directions[cover & (grid.weights > 0)]
    outside = coverage._distance(SPHERE.directions, seen) > math.radians(31)
    assert np.abs(values[outside]).max() < 0.02
    if kind in ("full", "empty"):
        inner = field(evidence, where=middle)
        assert inner == pytest.approx(float(Calibration().log_ratio(response[0, 0])), rel=0.25), (
            "and is kept where seen"
        )


@pytest.mark.parametrize("spread", [0.0, math.radians(6)])
@given(rotations())
@settings(max_examples=10)
def test_a_turned_view_is_the_turned_evidence(spread, R):
    response, calibration = np.random.default_rng(0).random((12, 16)), Calibration(spread=spread)
    ahead = Evidence.from_response(response, PerspectiveGrid(12, 16, 1.6), calibration)
    turned = Evidence.from_response(response, PerspectiveGrid(12, 16, 1.6, R), calibration)
    assert np.allclose(turned.coefficients(7), RealHarmonics(7).rotate(ahead.coefficients(7), R), atol=1e-10)


@pytest.mark.parametrize("kind", [np.asarray, torch.tensor], ids=["numpy", "torch"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_partial_coverage_is_kept_when_the_look_is_read_anew(kind, dtype):
    rng = np.random.default_rng(1)
    response, cover = rng.random(PATCHES.shape).astype(dtype), np.clip(rng.uniform(-0.3, 1.3, PATCHES.shape), 0, 1)
    made = kind(response)
    other = Calibration(floor=0.1, temperature=1.5)
    evidence = Evidence.from_response(made, PATCHES, coverage=cover)
    assert np.array_equal(evidence.coverage, cover)
    assert np.allclose(evidence.response[cover > 0], response[cover > 0], atol=1e-3 if dtype == np.float32 else 1e-9)
    direct = Evidence.from_response(made, PATCHES, other, coverage=cover)
    read = evidence.with_calibration(other)
    assert np.allclose(read.log_ratio, direct.log_ratio, atol=1e-4)
    assert read.seen == direct.seen
    assert np.allclose(read.with_calibration(evidence.calibration).log_ratio, evidence.log_ratio, atol=1e-4)
    half = Evidence.from_response(made, PATCHES, coverage=np.full(PATCHES.shape, 0.5)).with_calibration(other)
    assert np.allclose(half.log_ratio, 0.5 * other.log_ratio(response), atol=1e-4), "also where every cell was seen"
    assert Evidence.from_response(made, PATCHES, coverage=np.ones(PATCHES.shape)).coverage is None


def test_masks_that_differ_with_every_look_do_not_fill_the_memory(monkeypatch):
    from eagor import _arrays

    monkeypatch.setattr(_arrays, "RECENT_BYTES", 300_000)
    rng = np.random.default_rng(0)
    for _ in range(12):
        Evidence.from_response(np.zeros(PATCHES.shape), PATCHES, coverage=rng.random(PATCHES.shape) > 0.5).coefficients(
            7
        )
    assert sum(table.nbytes for table in _arrays._recent.values()) <= 300_000
    assert len(_arrays._recent) > 2


@pytest.mark.parametrize("kind", [np.asarray, torch.tensor], ids=["numpy", "torch"])
@pytest.mark.parametrize("calibration", [Calibration(), Calibration.paper()], ids=["default", "paper"])
def test_what_was_not_covered_may_be_anything(kind, calibration):
    """As the error about NaN advises."""
    response = np.random.default_rng(2).random(PATCHES.shape) * 0.5
    cover = (PATCHES.directions[..., 2] > -0.4).astype(float)
    clean = Evidence.from_response(response * cover, PATCHES, calibration, coverage=cover)
    for bad in (np.nan, np.inf, -3.0, 255.0):
        dirty = kind(np.where(cover > 0, response, bad))
        with pytest.raises(ResponseError, match=r"coverage|wanted \[0, 1\]"):
            Evidence.from_response(dirty, PATCHES, calibration)
        found = Evidence.from_response(dirty, PATCHES, calibration, coverage=cover)
        assert np.allclose(found.log_ratio, clean.log_ratio)
        assert found.peak == clean.peak
    dirty = np.where(cover > 0, np.nan, response)
    with pytest.raises(ResponseError, match="coverage"):
        Evidence.from_response(dirty, PATCHES, calibration, coverage=cover)


@pytest.mark.parametrize(
    ("azimuth_deg", "elevation_deg"), [(0, 0), (64, -34), (179, 5), (-178, -20), (90, 60), (-120, 85)]
)
def test_a_box_points_to_its_middle(azimuth_deg, elevation_deg):
    """Also across the seam."""
    grid = ErpGrid(512, 1024)
    x = (180 - azimuth_deg) / 360 * 1024
    y = (90 - elevation_deg) / 180 * 512
    target = direction(math.radians(azimuth_deg), math.radians(elevation_deg))
    half_x, half_y = 20 / max(0.2, math.cos(math.radians(elevation_deg))), 12
    box = [x - half_x, y - half_y, x + half_x, y + half_y]
    assert np.degrees(angular_distance(brightest(Evidence.from_boxes([box], grid)), target)) < 3.5


def test_boxes_in_a_view_and_several_boxes():
    grid = PerspectiveGrid(1080, 1920, math.radians(100), rotation((0, 0, 1), 1.0))
    evidence = Evidence.from_boxes([[1500, 500, 1600, 600], [200, 500, 260, 560]], grid, scores=[0.9, 0.4])
    target = grid.unproject(np.array(1550.0), np.array(550.0))
    assert np.degrees(angular_distance(brightest(evidence), target)) < 4
    assert evidence.response.max() == pytest.approx(0.9, abs=0.02)
    other = evidence.grid.project(grid.unproject(np.array(230.0), np.array(530.0)))
    assert evidence.response[int(other[1]), int(other[0])] == pytest.approx(0.4, abs=0.05)


def test_points_are_von_mises_fisher_bumps():
    target = direction(2.0, -0.4)
    evidence = Evidence.from_points([target], 1 / 0.15**2, [0.8])
    assert np.degrees(angular_distance(brightest(evidence), target)) < 3
    off = angular_distance(evidence.grid.directions, target)
    assert np.allclose(evidence.response, 0.8 * np.exp((np.cos(off) - 1) / 0.15**2), atol=1e-6)


@pytest.mark.parametrize("grid", [ErpGrid(128, 256), PerspectiveGrid(96, 96, math.pi / 2)], ids=["sphere", "view"])
@pytest.mark.parametrize("azimuth_deg", [20, -30, 179.5])
def test_a_small_mask_counts_like_a_small_box(grid, azimuth_deg):
    """Cut at degree 15, three degrees of mask as they are would be less than nothing at all."""
    if isinstance(grid, PerspectiveGrid) and azimuth_deg > 90:
        grid = replace(grid, body_R_view=rotation((0, 0, 1), math.pi))
    there = direction(math.radians(azimuth_deg), math.radians(-5))
    mask = grid.directions @ there > math.cos(math.radians(1.5))
    assert mask.any()
    small, raw = (
        field(Evidence.from_mask(mask, grid, None, Calibration(), min_spread=spread))
        for spread in (math.radians(4), 0.0)
    )
    point = field(Evidence.from_points(there, 1 / math.radians(4) ** 2, grid=grid, calibration=Calibration()))
    assert small.max() == pytest.approx(point.max(), rel=0.1)
    assert raw.max() < 0.4 < 1.2 < small.max()
    assert angular_distance(brightest(Evidence.from_mask(mask, grid, calibration=Calibration())), there) < math.radians(
        3
    )


def test_a_mask_that_is_wide_enough_is_taken_at_its_word():
    grid = ErpGrid(128, 256)
    wide = grid.directions @ direction(2.0, 0.3) > math.cos(math.radians(12))
    ring = wide & (grid.directions @ direction(2.0, 0.3) < math.cos(math.radians(9)))
    for mask in (wide, ring, np.ones(grid.shape, bool), np.zeros(grid.shape, bool)):
        evidence = Evidence.from_mask(mask, grid, [0.7], Calibration())
        assert np.array_equal(evidence.log_ratio, Evidence.from_response(mask * np.float32(0.7), grid).log_ratio)


@pytest.mark.parametrize("grid", [ErpGrid(128, 256), PerspectiveGrid(96, 96, math.pi / 2)], ids=["sphere", "view"])
@pytest.mark.parametrize("azimuth_deg", [20, -30])
def test_boxes_and_masks_are_detections_in_the_middle_as_wide_as_they_are_and_as_the_detector_errs(grid, azimuth_deg):
    there, model = direction(math.radians(azimuth_deg), math.radians(-5)), DetectorModel(0.7, 0.2, math.radians(3))
    for radius in (1.5, 12.0):
        mask = grid.directions @ there > math.cos(math.radians(radius))
        rows, columns = np.nonzero(mask)
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        for evidence in (
            Evidence.from_mask(mask, grid, detector=model),
            Evidence.from_boxes([box], grid, detector=model),
        ):
            (found,) = evidence.detections.directions
            assert math.degrees(angular_distance(found, there)) < 1, "half a cell"
            wide = np.degrees(1 / np.linalg.norm(evidence.detections.axes[0], axis=-1))
            assert wide == pytest.approx(math.hypot(3, radius / 2), rel=0.2), "a quarter of a disc's radius squared"
            # Cut at degree 15 and tapered at the border of a view, it is drawn towards the middle there.
            assert math.degrees(angular_distance(brightest(evidence), there)) < (3 if isinstance(grid, ErpGrid) else 4)


def test_two_masks_are_two_detections_and_an_empty_one_is_none():
    """As a response map they take the best score where they overlap."""
    masks = np.zeros((3, *PATCHES.shape), bool)
    masks[0, 3:6, 4:8] = masks[1, 5:8, 6:10] = True
    mapped = Evidence.from_mask(masks, PATCHES, [0.3, 0.9, 0.5], Calibration())
    assert [mapped.response[at] for at in ((4, 5), (5, 7), (0, 0))] == pytest.approx([0.3, 0.9, 0.0], abs=1e-6)
    evidence = Evidence.from_mask(masks, PATCHES, scores=[0.3, 0.9, 0.5])
    assert evidence.detections.scores.tolist() == [0.3, 0.9]
    assert evidence.detections.views == ()
    assert evidence.detections.joined(evidence.detections).scores.tolist() == [0.3, 0.9, 0.3, 0.9]


@pytest.mark.parametrize("dtype", [">f4", ">f8", "<f4", "<f8", "f2", np.longdouble])
@pytest.mark.parametrize("grid", [PATCHES, ErpGrid(512, 1024)], ids=["small", "large"])
def test_every_order_of_bytes_and_every_float_is_checked_and_read_alike(grid, dtype):
    """In the other order of bytes NaN has the bits of a small number; and the last value of a large map counts."""
    response = np.random.default_rng(4).random(grid.shape).astype(dtype)
    response[3, 4] = -0.0
    found = Evidence.from_response(response, grid).log_ratio
    assert np.allclose(found, Calibration().log_ratio(response.astype(np.float64)), atol=1e-5)
    assert found.dtype in (np.float32, np.float64)
    for bad in (np.nan, np.inf, -np.inf, 1.001, -0.001):
        response[-1, -1] = bad
        with pytest.raises(ResponseError):
            Evidence.from_response(response, grid)


BAD_RESPONSES = {
    "NaN": np.full(PATCHES.shape, np.nan),
    "infinite": np.where(np.arange(24) == 3, np.inf, np.zeros(PATCHES.shape)),
    "1.5": np.full(PATCHES.shape, 1.5),
    "-0.1": np.full(PATCHES.shape, -0.1),
    "255": np.full(PATCHES.shape, 255, np.uint8),
    "12, 23": np.zeros((12, 23)),
    "at least one": np.zeros((0, 12, 24)),
    "shape": np.zeros(5),
}


@pytest.mark.parametrize("text", BAD_RESPONSES)
@pytest.mark.parametrize("kind", [np.asarray, np.float32, torch.tensor], ids=["numpy", "numpy32", "torch"])
def test_bad_responses_are_refused_with_a_reason(text, kind):
    with pytest.raises(ResponseError, match=text):
        Evidence.from_response(kind(BAD_RESPONSES[text]), PATCHES)


@pytest.mark.parametrize(
    "response",
    [
        np.full(PATCHES.shape, 0.5 + 0.5j),
        np.full(PATCHES.shape, "0.5"),
        np.full(PATCHES.shape, 0.5, object),
        np.zeros(PATCHES.shape, "m8[s]"),
        np.ma.masked_array(np.zeros(PATCHES.shape), mask=True),
        torch.zeros(PATCHES.shape, dtype=torch.complex64),
    ],
    ids=lambda r: str(r.dtype),
)
def test_what_is_no_array_of_real_numbers_is_refused(response):
    with pytest.raises(ResponseError, match=r"wanted an array of real numbers"):
        Evidence.from_response(response, PATCHES)


VIEW = PerspectiveGrid(48, 64, math.radians(80))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Evidence.from_boxes([[10, 10, 10, 20]], ErpGrid(64, 128)), "wanted"),
        (lambda: Evidence.from_boxes([[500, 500, 600, 600]], PerspectiveGrid(64, 64, 1.0)), "wanted"),
        (lambda: Evidence.from_boxes([[1, 1, 5, 5]], ErpGrid(64, 128), scores=[1.2]), "scores must be 1 numbers"),
        (lambda: Evidence.from_boxes(np.ones((4, 5)), VIEW), r"boxes have shape \(4, 5\); wanted \(n, 4\)"),
        (lambda: Evidence.from_points(np.ones((3, 2)), 50.0), r"directions have shape \(3, 2\); wanted \(n, 3\)"),
        (lambda: Evidence.from_points([[1, 0, 0]], -1.0), "wanted"),
        (lambda: Evidence.from_points([[0, 0, 0]], 1.0), "zero vector"),
        (lambda: Evidence.from_mask(np.full(VIEW.shape, 0.1), VIEW), "threshold"),
        (
            lambda: Evidence.from_response(np.zeros(PATCHES.shape), PATCHES, coverage=np.full(PATCHES.shape, 2.0)),
            "coverage must",
        ),
        (lambda: Evidence.from_response(np.zeros(PATCHES.shape), PATCHES, stamp=math.nan), "capture"),
        (lambda: Calibration(floor=0.0), "wanted"),
        *[(lambda spread=s: Calibration(spread=spread), "1 to 30 degrees") for s in (-0.1, 0.01, 0.6, math.nan)],
    ],
)
def test_bad_detections_are_refused(make, text):
    with pytest.raises(EagorError, match=text):
        make()


def test_a_mask_on_a_fisheye_of_the_whole_sphere_ends_where_the_mask_does():
    """The corners of its square repeat directions that were seen."""
    grid = FisheyeGrid(80, 2 * math.pi)
    where = coverage.region(grid, grid.directions @ direction(0.0, 0.0) < 0.9)
    weight = coverage.taper(15, where, np.zeros(1))
    assert (weight[(grid.weights > 0) & (grid.directions[..., 0] < 0.5)] == 1).all()


def test_evidence_does_not_share_memory_with_the_caller():
    response, cover = np.zeros(PATCHES.shape), np.full(PATCHES.shape, 0.5)
    evidence = Evidence.from_response(response, PATCHES, coverage=cover)
    before = evidence.coefficients(7)
    response += 1
    cover[:] = 0.0
    assert np.array_equal(evidence.coefficients(7), before)
    assert (evidence.coverage == 0.5).all()


def test_the_logarithm_comes_before_the_integral():
    """On sparse maps upsampling first is wrong by more than half; patches must agree with pixels of the same values."""
    rng = np.random.default_rng(0)
    response = (rng.random((37, 74)) > 0.99).astype(float)
    patches = Evidence.from_response(response, PatchGrid(37, 74), Calibration.paper()).coefficients(7)
    pixels = Evidence.from_response(np.kron(response, np.ones((8, 8))), PatchGrid(296, 592), Calibration.paper())
    assert np.allclose(patches, pixels.coefficients(7), atol=1e-9)


SPREAD = math.radians(4)
FINE = PatchGrid(40, 80)


def test_a_small_thing_keeps_its_height_where_ratios_are_averaged_and_loses_it_where_logarithms_are():
    """One cell of 4.5 degrees, seen for sure, against a weak response that is wide: truncation turns them around."""
    sharp = Calibration(floor=0.1, temperature=2.0)
    response = np.zeros(FINE.shape)
    response[20, 10] = 0.9
    response[17:24, 57:64] = 0.2
    small, wide = FINE.directions[20, 10], FINE.directions[20, 60]
    high = sharp.log_ratio(np.array(0.9))
    for spread, found, least, most in ((0.0, wide, -1.0, 0.0), (SPREAD, small, 0.4, 1.0)):
        evidence = Evidence.from_response(response, FINE, replace(sharp, spread=spread))
        at = RealHarmonics(15).synthesise(evidence.coefficients(15), small)
        assert least * high < at < most * high
        assert math.degrees(angular_distance(brightest(evidence), found)) < 4.5


@pytest.mark.parametrize(
    ("view", "degrees"),
    [
        (PerspectiveGrid(12, 16, 1.6), 6),
        (PerspectiveGrid(60, 80, 1.6), 8),
        (PerspectiveGrid(50, 70, 2.4), 12),
        (FisheyeGrid(30, math.pi), 8),
        (FisheyeGrid(40, 2 * math.pi), 10),
    ],
    ids=lambda v: str(getattr(v, "shape", v)),
)
def test_a_view_laid_out_on_a_panorama_is_averaged_as_by_integrals_over_its_pixels(view, degrees):
    rng, calibration, spread = np.random.default_rng(0), Calibration(), math.radians(degrees)
    block = np.zeros(view.shape)
    height, width = view.shape
    block[height // 2 : height // 2 + height // 6, width // 3 : width // 3 + height // 6] = 0.9
    for response in (block, rng.random(view.shape) ** 4, np.ones(view.shape)):
        log_ratio = calibration.log_ratio(response)
        found, grid = averaged(log_ratio, view, spread, calibration.empty, calibration.full)
        basis = RealHarmonics(grid.height)
        gain = basis.synthesise(basis.smooth(basis.analyse(np.expm1(log_ratio), view), spread), grid)
        exact = np.log1p(np.clip(gain, math.expm1(calibration.empty), math.expm1(calibration.full)))
        assert np.abs(found - exact).max() < 0.04
        mass, meant = (np.sum(np.expm1(values) * g.weights) for values, g in ((found, grid), (log_ratio, view)))
        assert mass == pytest.approx(meant, rel=0.01)


def test_averaging_takes_batches_and_tensors_alike():
    response = np.random.default_rng(3).random((2, *PATCHES.shape))
    calibration = Calibration(spread=math.radians(5))
    for grid in (PATCHES, PerspectiveGrid(*PATCHES.shape, 1.5, rotation((1, 2, 3), 0.7))):
        both = Evidence.from_response(response, grid, calibration).coefficients(9)
        for one, expected in zip(response, both, strict=True):
            assert np.allclose(Evidence.from_response(one, grid, calibration).coefficients(9), expected, atol=1e-12)
        tensors = Evidence.from_response(torch.tensor(response), grid, calibration).coefficients(9)
        assert np.allclose(tensors.numpy(), both, atol=1e-10)
