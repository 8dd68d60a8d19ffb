"""What a belief must obey, and what its read-outs mean."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import directions, field, rotations

from eagor.belief import Belief
from eagor.errors import DirectionError, EagorError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.grids import ErpGrid, PatchGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid
from eagor.sphere import angular_distance, direction, rotation, unit

SEEDS = st.integers(0, 500)
FINE = ErpGrid(384, 768)
FINEST = ErpGrid(1024, 2048)


def look(*targets, concentration=60.0, scores=None):
    return Evidence.from_points(np.array(targets), concentration, scores)


def fine_posterior(belief, grid=FINE):
    f = belief.basis.synthesise(belief.coefficients, grid)
    total = f.max() + math.log(np.sum(np.exp(f - f.max()) * grid.weights))
    return f, total, np.exp(f - total) * grid.weights


@given(st.permutations(range(5)), SEEDS)
@settings(max_examples=20)
def test_evidence_in_any_order_gives_the_same_belief(order, seed):
    rng = np.random.default_rng(seed)
    looks = [Evidence.from_response(rng.random((8, 16)), PatchGrid(8, 16)) for _ in range(5)]
    forward, shuffled = Belief.uniform(7), Belief.uniform(7)
    for i in range(5):
        forward, shuffled = forward.update(looks[i]), shuffled.update(looks[order[i]])
    assert np.allclose(forward.coefficients, shuffled.coefficients, atol=1e-12)


@given(SEEDS, rotations(), rotations())
@settings(max_examples=25)
def test_late_evidence_equals_on_time_after_one_rotation(seed, first, second):
    rng = np.random.default_rng(seed)
    early, later = (Evidence.from_response(rng.random((8, 16)), PatchGrid(8, 16)) for _ in range(2))
    on_time = Belief.uniform(7).predict(first).update(early).predict(second).update(later)
    late = Belief.uniform(7).predict(first).predict(second).update(later).update(early, new_R_capture=second)
    assert np.abs(on_time.coefficients - late.coefficients).max() < 1e-12


@given(rotations(), directions())
@settings(max_examples=40)
def test_the_mode_turns_with_the_body(R, target):
    belief = Belief.uniform(7).update(look(target))
    assert np.degrees(angular_distance(belief.predict(R).mode(), R @ belief.mode())) < 0.1
    assert np.degrees(angular_distance(belief.mode(), target)) < 0.1
    assert np.allclose(belief.predict(R).mean_direction(), R @ belief.mean_direction(), atol=1e-12)


@pytest.mark.parametrize("degree", [3, 7, 15, 31])
@given(target=directions())
@settings(max_examples=20)
def test_the_mode_is_far_finer_than_its_grid(degree, target):
    basis = RealHarmonics(degree)
    belief = Belief(basis.smooth(basis.evaluate(target), 0.1))
    assert np.degrees(angular_distance(belief.mode(), target)) < 0.1


def test_the_published_estimate_is_the_first_moment_of_the_log_field():
    belief = Belief(field(7, 4))
    f = belief.log_ratio(FINE)
    moment = np.einsum("ij,ijk->k", f * FINE.weights, FINE.directions)
    assert np.allclose(belief.mean_direction(), moment / np.linalg.norm(moment), atol=1e-9)
    assert belief.resultant() == pytest.approx(np.linalg.norm(moment) / np.sum(f * FINE.weights), rel=1e-9)
    only_degree_one = Belief(np.where(np.arange(64) < 4, belief.coefficients, 0.0))
    assert np.allclose(only_degree_one.mean_direction(), belief.mean_direction()), "it depends on degree 1 alone"


@pytest.mark.parametrize(("degree", "height"), [(7, 20), (15, 60), (31, 30)])
def test_regions_entropy_and_presence_match_a_fine_quadrature(degree, height):
    c = field(degree, degree + height, width=0.12)
    c *= height / np.ptp(RealHarmonics(degree).synthesise(c, ErpGrid(64, 128)))
    belief = Belief(c)
    f, total, probability = fine_posterior(belief, FINEST)
    assert belief.entropy() == pytest.approx(total - np.sum(probability * f), abs=4e-3)
    assert belief.presence(0.3) == pytest.approx(
        0.3 * np.exp(total) / (4 * math.pi) / (0.3 * np.exp(total) / (4 * math.pi) + 0.7), abs=1e-3
    )
    for mass in (0.5, 0.9) if height < 60 else (0.9,):  # a sharper region of 50 % outruns the reference itself
        region = belief.credible_region(mass)
        inside = f - total >= region.threshold
        assert probability[inside].sum() == pytest.approx(mass, abs=1e-3)
        assert region.area == pytest.approx(FINEST.weights[inside].sum(), rel=0.02)
        assert (region.contains(FINEST.directions[::100, ::100]) == inside[::100, ::100]).all()
        cone = angular_distance(FINEST.directions, region.mode) <= region.angle
        assert probability[cone].sum() == pytest.approx(mass, abs=5e-3)
    assert belief.log_density(np.array([1.0, 0, 0])) == pytest.approx(float(belief.log_density(np.eye(3))[0]))
    assert belief.credible_region(0.9).contains(belief.mode())
    assert np.sum(np.exp(belief.log_density(FINE.directions)) * FINE.weights) == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("height", [1e3, 1e6])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.3, -0.5, 0.6), (0.0, 0.05, 1.0)])
def test_regions_of_thousands_of_nats(axis, height):
    """As docs/promises.md has it."""
    axis, degree = unit(np.array(axis)), 7
    grid = decoding_grid(degree)
    belief = Belief(height * RealHarmonics(degree).analyse(grid.directions @ axis, grid))
    # Of exp(k cos(angle)) the cone with 1 - cos(angle) = -log(1 - mass) / k holds the mass.
    cap = math.log(10) / height
    region = belief.credible_region(0.9)
    assert region.area == pytest.approx(2 * math.pi * cap, rel=0.03)
    assert region.threshold == pytest.approx(math.log(height / (2 * math.pi)) - math.log(10), abs=0.1)


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_a_density_is_read_at_unit_vectors_alone(kind):
    """The harmonics are polynomials: at twice the length they would be anything."""
    make = np.array if kind == "numpy" else lambda v: pytest.importorskip("torch").tensor(np.array(v))
    belief = Belief(make(field(7, 4)))
    exact, rounded = make([[0.6, 0.0, 0.8]]), make([[0.601, 0.0, 0.801333333333]])
    readers = belief.log_density, belief.log_ratio, belief.basis.evaluate
    for read in readers:
        assert np.allclose(read(rounded), read(exact), atol=1e-9), "rounding is taken out"
        for bad in ([[1.2, 0.0, 1.6]], [[0.0, 0.0, 0.0]], [[np.nan, 0.0, 1.0]], [[np.inf, 0.0, 0.0]]):
            with pytest.raises(DirectionError, match="unit vectors"):
                read(make(bad))
    with pytest.raises(DirectionError, match="unit vectors"):
        belief.basis.synthesise(belief.coefficients, make([0.0, 0.0, 3.0]))


def test_knowing_nothing():
    belief = Belief.uniform(7)
    assert belief.entropy() == pytest.approx(math.log(4 * math.pi))
    assert belief.presence(0.2) == pytest.approx(0.2)
    assert np.allclose(belief.mode(), [1, 0, 0])
    assert np.allclose(belief.mean_direction(), [1, 0, 0])
    found, weights = belief.modes(3)
    assert found.shape == (1, 3)
    assert weights == pytest.approx([1.0])
    assert belief.log_density(np.eye(3)) == pytest.approx(-math.log(4 * math.pi))


def test_modes_are_the_targets_strongest_first_and_weights_share_the_belief():
    a, b, c = direction(0.2, -0.1), direction(2.0, 0.3), direction(-2.2, -0.4)
    belief = Belief.uniform(15)
    for _ in range(3):
        belief = belief.update(look(a, b, c, scores=[0.5, 0.4, 0.45]))
    found, weights = belief.modes(5)
    assert len(found) == 3
    for target, mode in zip((a, c, b), found, strict=True):
        assert np.degrees(angular_distance(target, mode)) < 2
    assert weights[0] > weights[1] > weights[2] > 0.02
    assert weights.sum() == pytest.approx(1, abs=0.05)
    assert np.allclose(belief.modes(1)[0][0], belief.mode(), atol=1e-3)
    assert len(belief.modes(2)[0]) == 2


@pytest.mark.parametrize("degree", [7, 15, 31])
@pytest.mark.parametrize("looks", [1, 3, 10])
def test_the_rings_around_a_small_thing_are_no_candidates(degree, looks):
    there = direction(-0.4, -0.35)
    small = Evidence.from_points(there, 1 / math.radians(4) ** 2, calibration=Calibration(temperature=6.0))
    belief = Belief.uniform(degree)
    for _ in range(looks):
        belief = belief.update(small)
    found, _ = belief.modes(5)
    assert len(found) == 1
    assert angular_distance(found[0], there) < math.radians(1)


def test_a_belief_is_not_changed_through_the_array_that_it_was_made_of():
    array = field(7, 1)
    belief, kept = Belief(array), array.copy()
    array[:] = 0
    assert np.array_equal(belief.coefficients, kept)
    seen = belief.update(look(direction(0.3, 0.1)))
    for made in (belief, seen, belief.plus(kept), belief.predict(np.eye(3)), belief.forget(0.5), belief.diffuse(0.05)):
        with pytest.raises(ValueError, match="read-only"):
            made.coefficients[0] = 1.0
    with pytest.raises(AttributeError):
        belief.coefficients = kept
    assert np.array_equal(belief.coefficients, kept)


def test_a_belief_of_tensors_is_a_copy_that_gradients_go_through():
    torch = pytest.importorskip("torch")
    tensor = torch.tensor(field(7, 1), requires_grad=True)
    belief = Belief(tensor)
    before = belief.coefficients.detach().clone()
    (gradient,) = torch.autograd.grad(belief.forget(0.5).predict(rotation((0, 0, 1), 0.4)).coefficients.sum(), tensor)
    assert (gradient != 0).any()
    with torch.no_grad():
        tensor += 1
    assert torch.equal(belief.coefficients.detach(), before)


def test_forgetting_scales_the_odds():
    belief = Belief.uniform(7).update(look(direction(0.3, 0.1)))
    assert np.allclose(belief.forget(0.25).coefficients, 0.25 * belief.coefficients)
    assert belief.forget(0.0).entropy() == pytest.approx(math.log(4 * math.pi))


@pytest.mark.parametrize(("concentration", "degrees"), [(100, 4), (100, 1), (20, 10), (300, 2)])
@pytest.mark.parametrize("degree", [7, 15])
def test_diffusion_widens_a_peak_as_convolution_does(concentration, degrees, degree):
    """kappa 100 and 4 degrees give about 67, where the heat kernel on the log field leaves 99.5."""

    def resultant(belief):
        _, _, probability = fine_posterior(belief)
        return np.linalg.norm(np.einsum("ij,ijk->k", probability, FINE.directions))

    mu = direction(0.4, 0.3)
    c = np.zeros((degree + 1) ** 2)
    c[1:4] = concentration * np.array([mu[1], mu[2], mu[0]]) * math.sqrt(4 * math.pi / 3)
    belief, sigma = Belief(c), math.radians(degrees)
    exact = resultant(belief) * math.exp(-(sigma**2))  # the heat kernel on the degree-1 moment
    spread = 1 - resultant(belief.diffuse(sigma))
    assert spread == pytest.approx(1 - exact, rel=0.02)
    blurred = Belief(belief.basis.smooth(c, sigma))  # the heat kernel on f itself is no diffusion
    assert 1 - resultant(blurred) < 0.9 * (1 - exact) or degrees == 1
    assert belief.diffuse(sigma).presence(1e-9) == pytest.approx(belief.presence(1e-9), rel=0.01), "Z is kept"


@pytest.mark.parametrize("degree", [7, 15])
@pytest.mark.parametrize("degrees", [1, 4, 15])
@pytest.mark.parametrize("height", [1, 8, 40])
def test_diffusion_keeps_the_integral(degree, degrees, height):
    """Also in many steps, and where a peak is too steep for its degree: else presence would go up or down with time."""
    belief = Belief(height * field(degree, 3))
    spread = belief.diffuse(math.radians(degrees))
    grid = decoding_grid(degree)
    before, after = (np.log(np.sum(np.exp(b.log_ratio(grid)) * grid.weights)) for b in (belief, spread))
    assert after == pytest.approx(before, abs=1e-9)
    assert spread.posterior.log_total == pytest.approx(belief.posterior.log_total, abs=0.05 if height < 40 else 1.5)
    assert spread.entropy() > belief.entropy()


def test_batches_are_loops():
    beliefs = [Belief(6 * field(7, s)) for s in range(6)]
    batch = Belief(np.stack([b.coefficients for b in beliefs]).reshape(2, 3, -1))
    turns = np.stack([rotation((0, 1, 1), 0.3 * s) for s in range(6)]).reshape(2, 3, 3, 3)
    assert batch.mode().shape == (2, 3, 3)
    for i, b in enumerate(beliefs):
        at = divmod(i, 3)
        assert np.allclose(batch.mode()[at], b.mode(), atol=1e-9)
        assert np.allclose(batch.mean_direction()[at], b.mean_direction())
        assert batch.resultant()[at] == pytest.approx(float(b.resultant()))
        assert batch.entropy()[at] == pytest.approx(b.entropy())
        assert batch.presence()[at] == pytest.approx(b.presence())
        assert batch.credible_angle()[at] == pytest.approx(b.credible_angle())
        assert np.allclose(batch.predict(turns)[at].coefficients, b.predict(turns[at]).coefficients, atol=1e-12)
        assert np.allclose(batch.diffuse(0.05)[at].coefficients, b.diffuse(0.05).coefficients, atol=1e-12)
        directions_, weights = batch.modes(3)
        one, w = b.modes(3)
        assert np.allclose(directions_[at][: len(one)], one)
        assert np.allclose(weights[at][: len(w)], w)
        assert (weights[at][len(w) :] == 0).all()
    d = np.eye(3)
    assert np.allclose(batch.log_density(d)[1, 2], beliefs[5].log_density(d))
    with pytest.raises(EagorError, match="one belief"):
        batch.credible_region(0.9)


@pytest.mark.parametrize(
    "bad",
    [
        lambda b: b.forget(1.5),
        lambda b: b.forget(math.nan),
        lambda b: b.diffuse(-1),
        lambda b: b.credible_region(1.0),
        lambda b: b.presence(2.0),
        lambda b: Belief(np.zeros(63)),
        lambda b: b[0],
        lambda b: b.predict(np.diag([1.0, -1.0, 1.0])),
    ],
)
def test_bad_arguments_are_refused(bad):
    with pytest.raises(EagorError):
        bad(Belief.uniform(7))
