"""Pictures of what convergence.py measured, for docs/numerics.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def draw(curves: dict[str, Any], folder: str) -> None:
    """Draw each group that was measured into a PNG of `folder`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    Path(folder).mkdir(parents=True, exist_ok=True)
    for name, picture in (("orders", _orders), ("rates", _rates), ("histories", _histories), ("beams", _beams)):
        if name in curves:
            figure, axes = plt.subplots(figsize=(7.5, 4.8), layout="constrained")
            picture(axes, curves[name])
            axes.grid(alpha=0.3)
            axes.legend(fontsize=8)
            figure.savefig(Path(folder) / f"convergence-{name}.png", dpi=110)
            plt.close(figure)


def _orders(axes: Any, tables: dict[str, dict[int, dict[str, np.ndarray]]]) -> None:
    styles = {"phi L2": "o-", "surface L2": "s--", "vertex L2": "^:"}
    for colour, (name, table) in enumerate(tables.items()):
        cells = list(table)
        for what, style in styles.items():
            errors = [table[n][what][0] for n in cells]
            axes.loglog(cells, errors, style, color=f"C{colour}", label=f"{name}: {what}", markersize=4)
    ends = np.array([min(cells), max(cells)])
    axes.loglog(ends, 3e-3 * (ends / ends[0]) ** -2.0, "k-", linewidth=0.8, label="order 2")
    axes.set(xlabel="cells along the diameter", ylabel="relative error", title="Errors against exact solutions")


def _rates(axes: Any, rates: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    place = np.arange(len(rates))
    for offset, (index, label) in zip((-0.2, 0.2), enumerate(("two-point part", "defect correction")), strict=True):
        axes.bar(place + offset, [r[index].max() for r in rates.values()], 0.38, label=label)
    axes.set_xticks(place, list(rates), rotation=40, ha="right", fontsize=8)
    axes.set(ylabel="reduction per cycle", title="V(2,2), no absorption, worst of sigma_tr h = .05, .5, 5")


def _histories(axes: Any, histories: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    chosen = [name for name in ("sphere", "balls, gap .3h", "stack 2.2h", "D 100:1 sharp") if name in histories]
    for colour, name in enumerate(chosen):
        plain, accelerated = histories[name]
        axes.semilogy(plain, ":", color=f"C{colour}", label=f"{name}: plain")
        axes.semilogy(accelerated, "-", color=f"C{colour}", label=f"{name}: Anderson")
    axes.set(xlabel="cycles", ylabel="|r| / |Q|", title="Residuals of the worst channel")


def _beams(axes: Any, points: list[tuple[float, float, float, float]]) -> None:
    for colour, albedo in enumerate(sorted({albedo for _, albedo, _, _ in points})):
        depth, mean, rms = np.array([(d, m, r) for d, a, m, r in points if a == albedo]).T
        axes.loglog(depth, np.abs(mean), "o-", color=f"C{colour}", label=f"albedo {albedo}: |mean|")
        axes.loglog(depth, rms, "s--", color=f"C{colour}", label=f"albedo {albedo}: rms")
    axes.set(xlabel="sigma_tr h", ylabel="relative error", title="Lit side of a tilted plate")
