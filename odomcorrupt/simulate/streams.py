"""One random stream per layer, so that changing one layer leaves every other draw as it was."""

import zlib

import numpy as np


def stream(seed: int, layer: str) -> np.random.Generator:
    """Return the generator of one layer of one run.

    Parameters
    ----------
    seed : int
        Non-negative seed of the run.
    layer : str
        Name of what is drawn, such as ``"encoders"``.
    """
    return np.random.default_rng([seed, zlib.crc32(layer.encode())])
