"""Probability that an object can be moved, from the impulse of the hands on it and its displacement.

A logistic regression on two numbers of the push so far. Neither the learned model nor K is asked: they tell the two
classes apart less well, above all in the first second (docs/results.md).
"""

from __future__ import annotations

import math

from scipy.special import expit

# Fitted to touches of objects of training: python benchmarks/fit_mobility.py FOLDER
_BIAS = 18.787
_SLOPES = (3.354, -2.666)

_LEAST_MOVED = 0.02
"""So that the camera's noise on an object that stands still says nothing [m]."""


def features(moved: float, impulse: float) -> tuple[float, float]:
    """Features of the logistic regression for a push that has moved its object by ``moved`` [m] for ``impulse`` [N
    s]."""
    return math.log(moved + _LEAST_MOVED), math.log(impulse + 1.0)


def probability(moved: float, impulse: float) -> float:
    """P(manipulable) of an object that has come ``moved`` [m] while the hands spent ``impulse`` [N s] on it."""
    return float(expit(_BIAS + sum(slope * x for slope, x in zip(_SLOPES, features(moved, impulse), strict=True))))
