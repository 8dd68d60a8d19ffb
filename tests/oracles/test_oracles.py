"""Against other people's mathematics: closed forms, SciPy, ducc0, healpy, pyshtools, e3nn; and other arrays."""

import math

import array_api_strict
import ducc0
import healpy
import numpy as np
import pyshtools
import pytest
import torch
from e3nn import o3
from scipy.special import sph_harm_y
from strategies import field, random_directions

from eagor import conventions
from eagor.belief import Belief
from eagor.belief.ranged import RangedBelief
from eagor.evidence import Evidence
from eagor.grids import ErpGrid, PatchGrid, PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.sphere import angular_distance, azimuth_elevation, direction, rotation

DEGREES = [1, 7, 20]
D = random_directions(30, seed=5)
AZIMUTH, ELEVATION = azimuth_elevation(D)


@pytest.mark.parametrize("degree", [5, 63])
def test_the_basis_is_scipys(degree):
    """Real from complex: sqrt 2 (-1)^m Re / Im Y_lm, the Condon-Shortley phase taken out."""
    ours = RealHarmonics(degree).evaluate(D)
    for l in {0, 1, 2, degree // 2, degree}:
        for m in range(l + 1):
            theirs = sph_harm_y(l, m, math.pi / 2 - ELEVATION, AZIMUTH) * (-1) ** m * (math.sqrt(2) if m else 1)
            assert np.allclose(ours[:, l * l + l + m], theirs.real, atol=1e-11)
            if m:
                assert np.allclose(ours[:, l * l + l - m], theirs.imag, atol=1e-11)


@pytest.mark.parametrize("kappa", [0.5, 3.0, 10.0, 50.0])
def test_von_mises_fisher_coefficients_match_the_closed_form(kappa):
    """exp(kappa cos) expands with i_l(kappa), the modified spherical Bessel functions: 4 pi i_l(kappa) Y_lm(mu)."""
    from scipy.special import ive

    degree, mu = 15, D[3]
    basis, grid = RealHarmonics(degree), ErpGrid(128, 256)
    l = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    bessel = math.sqrt(math.pi / (2 * kappa)) * ive(l + 0.5, kappa)  # scaled by exp(-kappa)
    exact = 4 * math.pi * bessel * basis.evaluate(mu)
    found = basis.analyse(np.exp(kappa * (grid.directions @ mu - 1)), grid)
    assert np.abs(found - exact).max() < 1e-10


@pytest.mark.parametrize("degree", DEGREES)
def test_ducc_and_healpy_agree(degree):
    basis, c = RealHarmonics(degree), field(degree, 1, width=0.0)
    alm = conventions.to_healpix_alm(c)
    assert np.allclose(conventions.from_healpix_alm(alm), c, atol=1e-13)
    where = np.stack([math.pi / 2 - ELEVATION, AZIMUTH % (2 * math.pi)], axis=1)
    theirs = ducc0.sht.synthesis_general(alm=alm[None], lmax=degree, spin=0, loc=where, epsilon=1e-12)[0]
    assert np.allclose(basis.synthesise(c, D), theirs, atol=1e-9)
    nside = 64
    x, y, z = healpy.pix2vec(nside, np.arange(0, 12 * nside**2, 997))
    assert np.allclose(healpy.alm2map(alm, nside)[::997], basis.synthesise(c, np.stack([x, y, z], axis=-1)), atol=1e-9)


@pytest.mark.parametrize("degree", DEGREES)
def test_ducc_analyses_our_pixels_to_the_same_numbers(degree):
    """Its adjoint synthesis on the pixel-centre grid (F1) with quadrature weights is our analysis."""
    grid = ErpGrid(48, 96)
    image = np.random.default_rng(0).random(grid.shape)
    ours = RealHarmonics(degree).analyse(image, grid)
    # Their longitudes grow from phi0 to the left; our columns run from +pi downwards, so flip them.
    alm = ducc0.sht.adjoint_synthesis_2d(
        map=(image * grid.weights)[None, :, ::-1].copy(),
        spin=0,
        lmax=degree,
        geometry="F1",
        phi0=-math.pi + math.pi / 96,
    )[0]
    assert np.allclose(conventions.from_healpix_alm(alm), ours, atol=1e-11)


@pytest.mark.parametrize("degree", DEGREES)
def test_pyshtools_agrees(degree):
    basis, c = RealHarmonics(degree), field(degree, 2, width=0.0)
    theirs = pyshtools.SHCoeffs.from_array(conventions.to_pyshtools(c), normalization="ortho", csphase=1)
    values = [theirs.expand(lat=math.degrees(e), lon=math.degrees(a)) for a, e in zip(AZIMUTH, ELEVATION, strict=True)]
    assert np.allclose(np.ravel(values), basis.synthesise(c, D), atol=1e-11)
    assert np.allclose(conventions.from_pyshtools(conventions.to_pyshtools(c)), c)


@pytest.mark.parametrize("degree", [1, 7, 11])
def test_e3nn_agrees_on_values_and_rotations(degree):
    basis, c = RealHarmonics(degree), field(degree, 3, width=0.0)
    points = torch.tensor(conventions.to_e3nn_direction(D))
    theirs = o3.spherical_harmonics(list(range(degree + 1)), points, normalize=True, normalization="integral")
    assert np.allclose(theirs.numpy() @ c, basis.synthesise(c, D), atol=1e-10)
    R = rotation((1, 2, 0.3), 0.7)
    irreps = o3.Irreps("+".join(f"1x{l}e" for l in range(degree + 1)))
    wigner = irreps.D_from_matrix(torch.tensor(conventions.rotation_to_e3nn(R)))
    assert np.allclose(wigner.numpy() @ c, basis.rotate(c, R), atol=2e-4)  # e3nn's own precision


@pytest.fixture(params=["torch32", "torch64", "strict"])
def kind(request):
    if request.param == "strict":
        return array_api_strict.asarray, 1e-10
    dtype = torch.float32 if request.param == "torch32" else torch.float64
    return (lambda x: torch.tensor(np.asarray(x), dtype=dtype)), 1e-5 if dtype is torch.float32 else 1e-10


def close(theirs, ours, tolerance):
    array = theirs.numpy() if isinstance(theirs, torch.Tensor) else np.asarray(theirs)
    return np.allclose(array, ours, atol=tolerance, rtol=tolerance)


def test_other_arrays_in_other_arrays_out(kind):
    make, tolerance = kind
    basis, rng = RealHarmonics(7), np.random.default_rng(0)
    c, image = field(7, 0), rng.random((12, 24))
    turns = np.stack([rotation(rng.normal(size=3), rng.uniform(0, 3)) for _ in range(5)])
    batch = rng.normal(size=(5, 64))
    theirs = make(c)
    for found, expected in [
        (basis.evaluate(make(D)), basis.evaluate(D)),
        (basis.analyse(make(image), PatchGrid(12, 24)), basis.analyse(image, PatchGrid(12, 24))),
        (basis.analyse(make(image), ErpGrid(12, 24)), basis.analyse(image, ErpGrid(12, 24))),
        (basis.synthesise(theirs, ErpGrid(12, 24)), basis.synthesise(c, ErpGrid(12, 24))),
        (basis.synthesise(theirs, make(D)), basis.synthesise(c, D)),
        (basis.rotate(theirs, make(turns[0])), basis.rotate(c, turns[0])),
        (basis.rotate(make(batch), make(turns)), basis.rotate(batch, turns)),
        (basis.rotate(theirs, turns[0]), basis.rotate(c, turns[0])),
        (basis.rotate(make(batch), turns), basis.rotate(batch, turns)),
        (basis.smooth(theirs, 0.3), basis.smooth(c, 0.3)),
    ]:
        assert type(found) is type(theirs)
        assert found.dtype == theirs.dtype
        assert close(found, expected, 20 * tolerance)


def test_angles_of_other_arrays_beside_numpy_and_numbers(kind):
    make, tolerance = kind
    azimuths = np.linspace(-2, 2, 5)
    for found, expected in [
        (direction(make(azimuths), 0.3), direction(azimuths, 0.3)),
        (direction(0.3, make(azimuths / 2)), direction(0.3, azimuths / 2)),
        (angular_distance(make(D), D[0]), angular_distance(D, D[0])),
        (angular_distance([1, 0, 0], make(D)), angular_distance([1, 0, 0], D)),
    ]:
        assert type(found) is type(make(D))
        assert found.dtype == make(D).dtype
        assert close(found, expected, 20 * tolerance)


def test_arrays_stay_on_their_device():
    place, basis = array_api_strict.Device("device1"), RealHarmonics(5)
    view, R = PerspectiveGrid(18, 32, 1.5, rotation((0, 1, 1), 0.7)), rotation((1, 2, 3), 0.8)
    values = array_api_strict.ones(view.shape, dtype=array_api_strict.float64, device=place)
    c = basis.rotate(basis.analyse(values, view), R)
    assert {c.device, basis.synthesise(c, D).device, basis.synthesise(c, ErpGrid(8, 16)).device} == {place}


@pytest.mark.parametrize("grid", [PerspectiveGrid(18, 32, 1.5, rotation((0, 1, 1), 0.7)), PatchGrid(12, 24)])
def test_beliefs_of_other_arrays(kind, grid):
    make, tolerance = kind
    response = np.random.default_rng(0).random(grid.shape)
    ours = Belief.uniform(7).update(Evidence.from_response(response, grid))
    theirs = Belief.uniform(7, like=make([0.0])).update(Evidence.from_response(make(response), grid))
    R = rotation((1, 2, 3), 0.8)
    ours, theirs = ours.predict(R).forget(0.8), theirs.predict(make(R)).forget(0.8)
    assert close(theirs.coefficients, ours.coefficients, 20 * tolerance)
    assert close(theirs.mean_direction(), ours.mean_direction(), 1e3 * tolerance)
    assert close(theirs.mode(), ours.mode(), 1e3 * tolerance)
    assert theirs.presence() == pytest.approx(ours.presence(), abs=1e-4)
    assert close(theirs.diffuse(0.05).coefficients, ours.diffuse(0.05).coefficients, 1e3 * tolerance)


@pytest.mark.parametrize(("of", "values"), [(Belief, "coefficients"), (RangedBelief, "shells")])
def test_evidence_of_another_kind_is_brought_to_the_belief(kind, of, values):
    make, tolerance = kind
    grid, response = PatchGrid(12, 24), np.random.default_rng(0).random((12, 24))
    plain, foreign = Evidence.from_response(response, grid), Evidence.from_response(make(response), grid)
    R = rotation((1, 2, 3), 0.8)
    expected = of.uniform(7).update(plain)
    for start, look in [(of.uniform(7), foreign), (of.uniform(7, like=make([0.0])), plain)]:
        for found in (start.update(look), start.plus(look.coefficients(7))):
            sums, before, wanted = (getattr(each, values) for each in (found, start, expected))
            assert type(sums) is type(before)
            assert sums.dtype == before.dtype, "float64 stays float64, float32 stays float32"
            assert close(sums, wanted, 20 * tolerance)
        if isinstance(start, RangedBelief):
            each = start.update([look, plain] + 6 * [foreign, plain])
            assert type(each.shells) is type(start.shells)
            assert close(each.shells, expected.shells, 20 * tolerance)
        else:
            late = start.update(look, R)
            assert close(late.coefficients, of.uniform(7).update(plain, R).coefficients, 20 * tolerance)


def test_shells_of_other_arrays(kind):
    make, tolerance = kind
    c = np.stack([field(6, k) for k in range(14)])
    ours = RangedBelief(c, RangedBelief.uniform(6).ranges)
    theirs = RangedBelief(make(c), ours.ranges)
    R, step = rotation((1, 2, 3), 0.8), np.array([0.2, -0.1, 0.05])
    ours, theirs = ours.predict(R, step), theirs.predict(R, step)
    assert type(theirs.shells) is type(make(c))
    assert close(theirs.shells, ours.shells, 50 * tolerance)
    assert close(theirs.mode(), ours.mode(), 1e3 * tolerance)
    assert theirs.distance() == pytest.approx(ours.distance(), rel=1e-4)
