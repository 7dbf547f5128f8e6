"""What kernels must compute, in numpy: apps/bench_kernels.py checks each after it timed it.

A model takes the arguments of a launch by the names of the kernel's source, arrays in double precision and as they
were before it, and returns what must be in the arrays that it wrote.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clsss.sums import TILE

Arguments = dict[str, Any]
SPARE = [0, 1, 2, 2]  # the fourth channel repeats the third


def _per_face(a: Arguments, T: str = "T") -> np.ndarray:
    """Transmissibilities (n, 6, 1) or (n, 6, 4)."""
    values = a[T]
    return values[..., SPARE] if a["rows"] is None else values[a["rows"], :, None]


def _absorb(a: Arguments) -> np.ndarray:
    """Absorption (n, 4)."""
    return a["absorb"][:, SPARE] if a["rows"] is None else a["absorb"][np.minimum(a["rows"], a["last"])]


def _outflow(a: Arguments, x: np.ndarray, open_face: np.ndarray | float = 1.0) -> np.ndarray:
    """Residual b - A x of the first cells of `nbr`."""
    nbr, T = a["nbr"], _per_face(a)
    own = x[: len(nbr)]
    flux = T * (x[nbr] - own[:, None]) * open_face
    return a["b"][: len(nbr), SPARE] - _absorb(a) * own + flux.sum(axis=1)


def smooth(a: Arguments) -> Arguments:
    x, rows = a["x"].copy(), slice(a["first"], a["first"] + a["n"])
    T = _per_face(a)[rows]
    relaxed = (a["b"][rows][:, SPARE] + (T * x[a["nbr"][rows]]).sum(axis=1)) / (_absorb(a)[rows] + T.sum(axis=1))
    x[rows] += a["omega"] * (relaxed - x[rows])
    return {"x": x}


def residual(a: Arguments) -> Arguments:
    r = a["r"].copy()
    r[: a["n"]] = _outflow(a, a["x"])[:, :3]
    return {"r": r}


def residual_of_leaves(a: Arguments) -> Arguments:
    n, leaf, r = a["n"], a["is_leaf"].astype(bool), a["r"].copy()
    open_face = np.append(leaf, np.ones(len(a["x"]) - n, bool))[a["nbr"]]
    r[:n] = _outflow(a, a["x"], open_face[..., None])[:, :3] * leaf[:, None]
    return {"r": r}


def reflux(a: Arguments) -> Arguments:
    r, face = a["r"].copy(), a["ghost_face"]
    T = _per_face(a, "T_fine")
    ghosts = a["n_fine"] + np.arange(len(face))
    flux = T[face // 6, face % 6] * (a["x_fine"][face // 6] - a["x_fine"][ghosts])
    r[a["interface"]] += np.add.reduceat(flux, a["interface_start"][:-1])[:, :3]
    return {"r": r}


def _children(a: Arguments, values: np.ndarray, octants: Any = slice(None)) -> np.ndarray:
    """Sum over the children of every covered cell, or those in some octants."""
    padded = np.concatenate([values, np.zeros((1, values.shape[1]))])
    child = a["child"][:, octants]
    return padded[np.where(child < 0, len(values), child)].sum(axis=1)


def smooth_from_zero(a: Arguments) -> Arguments:
    x, rows = a["x"].copy(), slice(a["first"], a["first"] + a["n"])
    x[rows] = a["omega"] * a["b"][rows][:, SPARE] / (_absorb(a)[rows] + _per_face(a)[rows].sum(axis=1))
    return {"x": x}


def leave_residual(a: Arguments) -> Arguments:
    x = a["x"].copy()
    x[: a["n"]] = _outflow(a, a["x"])[: a["n"]]
    return {"x": x}


def restrict_residual(a: Arguments) -> Arguments:
    out = a["b_coarse"].copy()
    out[a["covered"]] = _children(a, a["residual"], [0, 3, 5, 6])[:, :3]
    return {"b_coarse": out}


def average(a: Arguments) -> Arguments:
    out = a["x_coarse"].copy()
    count = np.maximum((a["child"] >= 0).sum(axis=1), 1)[:, None]
    out[a["covered"]] = _children(a, a["x"]) / count
    return {"x_coarse": out}


def prolong(a: Arguments) -> Arguments:
    rows, x, parent, coarse = slice(a["first"], a["first"] + a["n"]), a["x"].copy(), a["parent"], a["x_coarse"]
    w, octant, nbr = a["weight"][:, :3] / 252, a["weight"][:, 3], a["nbr"][rows]
    x[rows] += (1 - w.sum(axis=1, keepdims=True)) * coarse[parent[rows]]
    for axis in range(3):
        outward = nbr[np.arange(a["n"]), 2 * axis + (octant >> axis & 1)]
        x[rows] += w[:, axis : axis + 1] * coarse[parent[outward]]
    return {"x": x}


def copy_ghosts(a: Arguments) -> Arguments:
    x, n = a["x"].copy(), a["n_cells"]
    x[n : n + a["n"]] = a["x_coarse"][a["parent"][n : n + a["n"]]]
    return {"x": x}


def _vector(value: Any) -> np.ndarray:
    return np.array(value.tolist(), float)


def combine(a: Arguments) -> Arguments:
    return {"y": _vector(a["a"]) * a["x"] + _vector(a["b"]) * a["y"]}


def _partial_sums(a: Arguments, terms: np.ndarray) -> Arguments:
    padded = np.concatenate([terms[:, SPARE], np.zeros((-a["n"] % TILE, 4))])
    return {"partial": padded.reshape(len(a["partial"]), TILE, 4).sum(axis=1)}


def inner_product(a: Arguments) -> Arguments:
    return _partial_sums(a, a["x"] * a["y"])


def total(a: Arguments) -> Arguments:
    return _partial_sums(a, a["x"])


MODELS = {
    model.__name__: model
    for model in (
        smooth, smooth_from_zero, residual, residual_of_leaves, reflux, leave_residual, restrict_residual, average,
        prolong, copy_ghosts, combine, inner_product, total,
    )
}  # fmt: skip


def verify(name: str, before: Arguments, after: Arguments, eps: float) -> str:
    """Compare: "numpy" where the kernel has a model and agrees with it, "" where it has none; otherwise the error.

    Parameters
    ----------
    before, after : dict
        Arguments of the launch, before and after it.
    eps : float
        Spacing of the device's numbers at 1.
    """
    if name not in MODELS:
        return ""
    model = {k: v.astype(float) if isinstance(v, np.ndarray) and v.dtype.kind == "f" and v.ndim else v
             for k, v in before.items()}  # fmt: skip
    terms = 0.0  # what cancels in sums of fluxes
    for T, x in (("T", "x"), ("T_fine", "x_fine")):
        if T in model and x in model:
            terms = float(np.abs(model[T]).max() * np.abs(model[x]).max())
    for key, expected in MODELS[name](model).items():
        size = max(float(np.abs(expected).max(initial=0)), float(np.abs(before[key]).max(initial=0)), terms, 1e-30)
        error = float(np.abs(after[key] - expected).max(initial=0)) / size
        if not error < 100 * eps:
            return f"{key} off by {error:.1e}"
    return "numpy"
