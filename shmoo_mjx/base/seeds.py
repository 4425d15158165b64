"""Seeds given by users: their allowed range for all commands, and the ranges reserved for unseen objects."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from shmoo_mjx.base.options import option, whole_number
from shmoo_mjx.errors import ShmooError

MAX_SEED = 2**31 - 1
"""Largest seed. All generators in use (NumPy, JAX, Gymnasium) accept it, with room for larger derived seeds."""

UNSEEN_SEED = 1_000_000
"""First seed of test objects, which training never uses. Each --condition-seed owns 1,000 seeds from here on."""

MAX_CONDITION_SEED = (MAX_SEED - UNSEEN_SEED) // 1000 - 1
"""Largest --condition-seed whose object seeds do not exceed MAX_SEED. Negative ones would give training objects."""


def check_seed(name: str, seed: int, highest: int = MAX_SEED) -> int:
    """Check a seed and return it.

    Args:
        name: name of the seed, for the error message.
        seed: seed to check.
        highest: largest allowed seed.

    Raises:
        ShmooError: the seed is below 0 or above ``highest``.
    """
    return seed_of(name, str(seed), highest)


def seed_of(name: str, text: str, highest: int = MAX_SEED) -> int:
    """Parse a seed.

    Args:
        name: name of the option, for the error message.
        text: text to parse.
        highest: largest allowed seed.

    Raises:
        ShmooError: the text is not a whole number from 0 to ``highest``.
    """
    return whole_number(name, 0, highest, text)


def seeds_of(text: str) -> range:
    """Parse one seed ("3") or a range of seeds ("0..19", both ends included).

    Raises:
        ShmooError: the text is neither.
    """
    first, dots, last = text.partition("..")
    start = seed_of("--seed", first)
    seeds = range(start, (seed_of("--seed", last) if dots else start) + 1)
    if not seeds:
        raise ShmooError(f"--seed {text!r} must begin with its smallest number, as 0..19 does.")
    return seeds


Seeds = Annotated[range, option(seeds_of, "SEED|FIRST..LAST")]
"""Type of a --seed option that accepts several seeds."""

Seed = Annotated[int, option(partial(seed_of, "--seed"), "SEED")]
"""Type of a --seed option with one seed."""

ConditionSeed = Annotated[int, option(partial(seed_of, "--condition-seed", highest=MAX_CONDITION_SEED), "SEED")]
"""Type of the option --condition-seed."""
