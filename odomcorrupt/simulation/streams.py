"""One random stream per layer, so that a change of one layer leaves the draws of all others unchanged."""

import zlib
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.signal import lfilter


def stream(seed: int, layer: str) -> np.random.Generator:
    """Return the generator of one layer of one run.

    seed : non-negative seed of the run
    layer : name of the layer, such as ``"encoders"``
    """
    return np.random.default_rng([seed, zlib.crc32(layer.encode())])


Streams: TypeAlias = Callable[[str], np.random.Generator]
"""The streams of one run by layer. Opening a layer restarts its stream, so each is opened once."""


def gauss_markov_noise(sigma: float, tau_s: float, step_s: float, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return a stationary Gauss-Markov sequence of deviation `sigma` and correlation time `tau_s`, shape (n,)."""
    stay = np.exp(-step_s / tau_s)
    draws = rng.normal(size=n)
    draws[1:] *= np.sqrt(1.0 - stay**2)
    return np.asarray(sigma * lfilter([1.0], [1.0, -stay], draws))
