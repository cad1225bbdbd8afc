"""Matrices of Gauss collocation on 16 nodes: generated/gauss.inc of the engine.

With nodes x_i of [-1, 1], Lagrange polynomials l_j and Chebyshev polynomials T_k,

* ``gauss_integral[j][i]`` = int_-1^x_i l_j,
* ``gauss_series[j][k]``, coefficients of T_k, k <= 15, of the antiderivative of l_j from -1 on,
* ``gauss_top[j]``, that of T_16,
* ``gauss_weight[j]`` = int_-1^1 l_j, ``gauss_last[j]`` = l_j(1),
* ``gauss_through[j][k]`` and ``gauss_through_top[j]``, coefficients of T_k, k <= 15, and of T_16,
  of the polynomial that is 1 at x_j, and 0 at -1 and the other nodes.

Dense output is a Chebyshev series because its recurrence takes one operation, Legendre's three.
All have 60 digits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebint, chebvander

N = 16


def gauss_arrays() -> dict[str, Any]:
    """Return the matrices by their names, with their sizes in C."""
    import mpmath

    def inverse(a: np.ndarray) -> np.ndarray:
        return np.array((mpmath.matrix(a.tolist()) ** -1).tolist())

    with mpmath.workdps(60):
        start = np.polynomial.legendre.leggauss(N)[0]
        nodes = [mpmath.findroot(lambda x: mpmath.legendre(N, x), float(x)) for x in start]
        # coefficients of l_j in column j, by the values of all T_k at the nodes
        lagrange = inverse(chebvander(nodes, N - 1))
        through = inverse(chebvander([mpmath.mpf(-1), *nodes], N))[:, 1:]
        series = chebint(lagrange, lbnd=-1)
        return {
            "node[L]": nodes,
            "integral[L][L]": (chebvander(nodes, N) @ series).T,
            "series[L][L]": series[:N].T,
            "top[L]": series[N],
            "weight[L]": series.sum(axis=0),
            "last[L]": lagrange.sum(axis=0),
            "through[L][L]": through[:N].T,
            "through_top[L]": through[N],
        }
