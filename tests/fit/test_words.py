"""Fits say in words what they found; those of many skies, or in a program, keep their structure."""

import jax
import jax.numpy as jnp

import atmofit as af

DOME = af.Directions(jnp.linspace(0.1, 1.4, 40), jnp.linspace(0.0, 3.0, 40) ** 2 % 3.0)
SUN = 0.8


def sky(turbidity):
    return af.PREETHAM_1999(turbidity, SUN, DOME)[:, 2]


def test_a_fit_of_perez_shows_its_coefficients():
    fit = af.fit_perez(DOME, SUN, sky(3.0))
    lines = str(fit).splitlines()
    assert lines[0].startswith("Perez, rms ")
    assert [line.split()[0] for line in lines[1:7]] == ["A", "B", "C", "D", "E", "scale"]
    assert f"{float(fit.coefficients[4]):.4g}" in lines[5]
    assert "±" in lines[5]
    many = jax.vmap(lambda t: af.fit_perez(DOME, SUN, sky(t)))(jnp.array([2.0, 4.0]))
    assert str(many) == repr(many)
    seen = []
    jax.eval_shape(lambda t: seen.append(str(af.fit_perez(DOME, SUN, sky(t)))), 3.0)
    assert seen[0].startswith("PerezFit(")


def test_an_estimate_says_what_it_is_worth():
    observed = af.Observation(DOME, sky(3.0), SUN, relative_noise=0.02)
    estimate = af.estimate_turbidity(observed, "preetham")
    text = str(estimate)
    assert "turbidity" in text
    assert f"{float(estimate.value):.4g} ± {float(estimate.standard_error):.2g}" in text
    assert "95 % interval of turbidity" in text
    assert "converged" not in text
