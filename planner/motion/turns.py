"""Whole turns of an arm's joints, coded as one number, and what they cost at states of some targets."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.motion.chain import TWO_PI
from planner.motion.reach import Rungs

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

CODE: Final = 16
"""Turns of joint j count CODE ** j."""


class Turns:
    """Penalties of the states of one arm by their whole turns, which are coded as one number."""

    def __init__(self, rungs: Rungs, states: list[IndexArray]) -> None:
        counts = np.round(rungs.turns / TWO_PI).astype(np.intp)
        codes = counts @ (CODE ** np.arange(6))
        self._least, span = int(codes.min()), int(codes.max() - codes.min()) + 1
        self._turns: dict[int, FloatArray] = {int(c): t for c, t in zip(codes, rungs.turns, strict=True)}
        self._place = np.full(span + 1, len(codes), dtype=np.intp)
        self._place[codes - self._least] = np.arange(len(codes))
        self._span = span
        self._penalty = [
            np.concatenate([rungs.penalty[k, s], np.full((len(s), 1), np.inf)], axis=1)
            for k, s in enumerate(states)
        ]
        self._codes = codes

    def starts(self) -> list[IndexArray]:
        """Turns of the first states that are tried: each one's best, then each of the turns for all."""
        best = self._codes[np.argmin(self._penalty[0][:, :-1], axis=1)]
        return [best, *(np.full(len(best), code, dtype=np.intp) for code in self._codes[1:])]

    def penalty(self, k: int, code: IndexArray) -> FloatArray:
        """Penalty (..., S) [s] of the states of rung k at turns (..., S), inf where these are not allowed."""
        at = code - self._least
        place = self._place[np.where((at < 0) | (at >= self._span), self._span, at)]
        return np.asarray(self._penalty[k][np.arange(code.shape[-1]), place])

    def turn(self, code: int) -> FloatArray:
        """Turns (6,) [rad] of a code."""
        return self._turns[code]
