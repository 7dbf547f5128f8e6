"""What a solve does next, from the residuals so far: how much of a correction counts, and what takes part in a cycle.

Errors that a cycle leaves are of cut cells: there A_1, which it inverts, differs from the second-order A_2, and the
eigenvalues of A_1^-1 A_2 spread alike to either side of 1. Two steps off 1, w and 2 - w, take more of both ends than
two of 1 would (Richardson's method with the steps of Chebyshev polynomials), and leave (1 - w)^2 of all else, which the
next cycle takes.

References
----------
Young 1954, "On Richardson's method for solving linear systems with positive definite matrices".
"""

from __future__ import annotations

from collections.abc import Sequence

OFF = 0.1  # how far two steps are off 1
ROUGH = 0.3  # of the residual, that the first cycle leaves at least where errors of cut cells prevail
FAR = 1e3  # tolerances that are left then: the cycles to come make up for what steps off 1 leave
NEARLY = 2.0  # tolerances from which on the last cycle need not couple what follows the solution
FAST = 0.15  # of the residual, that the cycle before that leaves at most


def share(history: Sequence[float], tolerance: float) -> float:
    """How much of the next cycle's correction counts, after residuals `history` (1 + cycles,)."""
    steps = (1.0, 1 - OFF, 1 + OFF)
    if not 2 <= len(history) <= len(steps) or history[1] <= max(ROUGH * history[0], FAR * tolerance):
        return 1.0
    return steps[len(history) - 1]


def without_coupling(history: Sequence[float], tolerance: float) -> bool:
    """Whether the next cycle, the last if all goes well, may leave out what follows the solution."""
    return len(history) > 1 and tolerance < history[-1] <= min(NEARLY * tolerance, FAST * history[-2])
