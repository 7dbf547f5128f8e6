"""What the benchmarks promise, print and write."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Target:
    """A measured figure and its bound; without a figure it was not measured in this run, without a bound it informs."""

    name: str
    figure: float | None
    bound: float | None = None
    unit: str = ""
    at_least: bool = False

    @property
    def verdict(self) -> str:
        """pass, FAIL, not run, or nothing; what is no number fails."""
        if self.figure is None:
            return "not run"
        if self.bound is None:
            return ""
        met = self.figure >= self.bound if self.at_least else self.figure <= self.bound
        return "pass" if met else "FAIL"

    def __str__(self) -> str:
        figure = "-" if self.figure is None else f"{self.figure:.3g} {self.unit}"
        bound = "" if self.bound is None else f"{'>=' if self.at_least else '<='} {self.bound:g} {self.unit}"
        return f"{self.name:<64} {figure:>10}  {bound:<10}  {self.verdict}"

    def record(self) -> dict[str, Any]:
        """For JSON."""
        return {**vars(self), "verdict": self.verdict}


def print_targets(targets: list[Target]) -> int:
    """Print them; how many are missed."""
    print("\ntargets")
    for target in targets:
        print(f"  {target}")
    return sum(target.verdict == "FAIL" for target in targets)


def add_outputs(parser: argparse.ArgumentParser, picture: str) -> None:
    """Where figures and a picture of `picture` go."""
    parser.add_argument("--json", metavar="FILE", help="write all figures to this file")
    parser.add_argument("--out", metavar="FOLDER", help=f"draw {picture} into this folder (needs matplotlib)")


def write_outputs(args: argparse.Namespace, figures: dict[str, Any], targets: list[Target], name: str,
                  draw: Callable[[Path], None]) -> None:  # fmt: skip
    """Write what `add_outputs` let ask for: figures and targets, and the picture `name` that `draw` makes."""
    if args.json:
        everything = {**figures, "targets": [target.record() for target in targets]}
        Path(args.json).write_text(json.dumps(everything, indent=1))
    if args.out:
        Path(args.out).mkdir(parents=True, exist_ok=True)
        draw(Path(args.out) / name)
