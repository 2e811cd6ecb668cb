"""Distributions and utilities as they are written: with the sums, and as many, as the original tools ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.models.compressed import csr, is_compressed
from mdm.models.factored.potential import Node, Table

if TYPE_CHECKING:
    from mdm.models import TwoSliceNetwork
    from mdm.models.factored.potential import Potential

__all__ = ["closed", "initial", "utilities"]

_CLOSE = 1e-14
"""MADP takes a sum within 5e-13, added one number after the other."""


def closed(distributions: Any) -> Any:
    """Return distributions along the last axis (rows of a CSR matrix), divided by their sums where these miss 1.

    A model's rows are within 1e-9 of 1. Most are closer, and stay as they are.
    """
    if not is_compressed(distributions):
        sums = np.add.accumulate(distributions, axis=-1)[..., -1:]
        return distributions / np.where(abs(sums - 1) > _CLOSE, sums, 1.0)
    sums = np.asarray(distributions.sum(axis=1)).ravel()
    sums[abs(sums - 1) <= _CLOSE] = 1
    data = distributions.data / np.repeat(sums, np.diff(distributions.indptr))
    return csr((data, distributions.indices, distributions.indptr), distributions.shape)


def initial(network: TwoSliceNetwork) -> list[Potential]:
    """Return a network's initial distributions; of those over a factor alone, the sums are as close to 1 as can be."""
    return [
        Table(each.scope, closed(each.values)) if isinstance(each, Table) and len(each.scope) == 1 else each
        for each in network.initial
    ]


def utilities(network: TwoSliceNetwork) -> tuple[Potential, ...]:
    """Return a network's utilities; one of 0 if there are none, for MADP and SARSOP need a reward."""
    return network.utilities or (Table([Node("action", 0)], np.zeros(len(network.actions.factors[0]))),)
