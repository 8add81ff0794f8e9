"""Read-only float arrays: the one way values hold vectors, matrices and point lists."""

from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]


def frozen(values: ArrayLike, shape: tuple[int, ...] | None = None) -> Floats:
    """Return `values` as a read-only float64 array of its own.

    Args:
        values: anything numpy understands.
        shape: the expected shape; -1 stands for any length along that axis.

    Raises:
        ValueError: if the shape differs.
    """
    array = np.array(values, dtype=np.float64)
    if shape is not None and (
        array.ndim != len(shape) or any(w not in (-1, g) for w, g in zip(shape, array.shape, strict=True))
    ):
        raise ValueError(f"expected shape {shape}, got {array.shape}")
    array.setflags(write=False)
    return array


def frozen_ints(values: ArrayLike | Iterable[int]) -> Ints:
    """Return `values` as a read-only int64 array of its own."""
    array = np.array(values, dtype=np.int64)
    array.setflags(write=False)
    return array


def freeze(array: NDArray[Any]) -> None:
    """Make an array read-only in place."""
    array.setflags(write=False)
