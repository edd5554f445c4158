"""The posterior of a calibration by Markov chains, where the normal law of its logarithms is not enough."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.calibration.fits import Fit
from warpriver.errors import InputError, MissingExtraError, warn
from warpriver.public import public
from warpriver.validate import seeded, shown, whole

__all__ = ["Posterior", "posterior"]

# Steps of a chain that are dropped, as a fraction; and the least number of independent samples of a constant.
BURN_IN, LEAST_SAMPLES = 0.3, 200.0
# Walkers begin about the fit, within so many of its standard errors.
SPREAD = 0.5


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Samples of the constants, from all walkers after the burn-in.

    Attributes:
        names: The constants.
        samples: (S, C) values.
        acceptance: Mean fraction of moves that were accepted; .2 to .5 is usual.
        autocorrelation: Steps over which the chain of each constant is alike, nan where it is too short to tell.
    """

    names: tuple[str, ...]
    samples: FloatArray
    acceptance: float
    autocorrelation: FloatArray

    def quantile(self, name: str, fraction: float) -> float:
        """A quantile of a constant."""
        if name not in self.names:
            raise InputError(f"{shown(name)} was not fitted; there are {', '.join(self.names)}")
        return float(np.quantile(self.samples[:, self.names.index(name)], fraction))


@public
def posterior(fit: Fit, *, walkers: int = 16, steps: int = 200, seed: int = 0) -> Posterior:
    """Sample the posterior of a fit's constants by an affine-invariant ensemble [Foreman2013].

    The likelihood is that of the fit: robust misfits, of which as many count as are independent along the river. All
    walkers of a step are simulated in one launch. Fields keep the values of the fit.

    Example::

        chains = wr.calibration.posterior(fit, steps=300)
        chains.quantile("memory_length", 0.05), chains.quantile("memory_length", 0.95)

    Args:
        fit: What :func:`calibrate` returned.
        walkers: Number of walkers, even, and at least twice the number of unknowns.
        steps: Steps of each walker; the first three tenths are dropped.
        seed: Seed of the chains.

    Returns:
        The samples.

    Raises:
        ImportError: emcee is missing.
        TypeError: An argument is of another kind.
        ValueError: Too few walkers or steps.
    """
    problem, count = fit.problem, len(fit.problem.names)
    free = [*range(count), *([problem.count - 2, problem.count - 1] if problem.offset else [])]
    walkers, steps = whole(walkers, "walkers", 2 * len(free)), whole(steps, "steps", 20)
    if walkers % 2:
        raise InputError(f"walkers is {walkers}; give an even number")
    rng = seeded(seed)
    emcee = _emcee()
    low, high = problem.bounds()

    def log_density(values: FloatArray) -> FloatArray:
        inside = ((values > low[free]) & (values < high[free])).all(axis=1)
        density = np.full(len(values), -np.inf)
        if inside.any():
            unknowns = np.tile(fit.unknowns, (int(inside.sum()), 1))
            unknowns[:, free] = values[inside]
            density[inside] = -problem.costs(unknowns)
        return density

    width = np.sqrt(np.diag(fit.covariance))[free]
    begin = fit.unknowns[free] + SPREAD * width * rng.standard_normal((walkers, len(free)))
    begin = np.clip(begin, low[free] + 1e-6, high[free] - 1e-6)
    sampler = emcee.EnsembleSampler(walkers, len(free), log_density, vectorize=True)
    sampler.random_state = np.random.RandomState(seed % 2**32).get_state()
    sampler.run_mcmc(begin, steps)
    dropped = int(BURN_IN * steps)
    alike = np.asarray(sampler.get_autocorr_time(tol=0, discard=dropped, quiet=True))[:count]
    kept = sampler.get_chain(discard=dropped, flat=True)[:, :count]
    if not (len(kept) / np.where(np.isfinite(alike), alike, np.inf)).min() >= LEAST_SAMPLES:
        warn(
            f"the chains are too short: {steps} steps hold few independent samples; give more steps, about "
            f"{int(np.nan_to_num(LEAST_SAMPLES * np.max(alike) / walkers / (1.0 - BURN_IN), nan=4.0 * steps)) + 1}"
        )
    return Posterior(problem.names, np.exp(kept), float(np.mean(sampler.acceptance_fraction)), alike)


def _emcee() -> Any:
    try:
        import emcee
    except ImportError as error:
        raise MissingExtraError('posterior needs emcee: pip install "warpriver[calibrate]"') from error
    return emcee
