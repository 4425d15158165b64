"""Seeds as users give them: one bounded kind for every command, and the border above which no training draws."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from shmoo_mjx.base.options import option, whole_number
from shmoo_mjx.errors import ShmooError

MAX_SEED = 2**31 - 1
"""What every generator we use (numpy, JAX, Gymnasium) takes, with room to count on from."""

UNSEEN_SEED = 1_000_000
"""First seed of the objects that no training can reach; each --condition-seed has 1,000 seeds of its own above it."""

MAX_CONDITION_SEED = (MAX_SEED - UNSEEN_SEED) // 1000 - 1
"""Largest one whose objects' seeds are seeds too. Below 0 they would be those of training."""


def check_seed(name: str, seed: int, highest: int = MAX_SEED) -> int:
    """The seed itself.

    Raises:
        ShmooError: it is below 0 or above ``highest``; ``name`` says whose it is.
    """
    return seed_of(name, str(seed), highest)


def seed_of(name: str, text: str, highest: int = MAX_SEED) -> int:
    """The seed that the text says.

    Raises:
        ShmooError: it is no whole number from 0 to ``highest``; ``name`` says which option it was given to.
    """
    return whole_number(name, 0, highest, text)


def seeds_of(text: str) -> range:
    """The seeds that "3" or "0..19" says.

    Raises:
        ShmooError: it is neither.
    """
    first, dots, last = text.partition("..")
    start = seed_of("--seed", first)
    seeds = range(start, (seed_of("--seed", last) if dots else start) + 1)
    if not seeds:
        raise ShmooError(f"--seed {text!r} must begin with its smallest number, as 0..19 does.")
    return seeds


Seeds = Annotated[range, option(seeds_of, "SEED|FIRST..LAST")]
"""The type of a --seed that may be several."""

Seed = Annotated[int, option(partial(seed_of, "--seed"), "SEED")]
"""The type of every --seed."""

ConditionSeed = Annotated[int, option(partial(seed_of, "--condition-seed", highest=MAX_CONDITION_SEED), "SEED")]
"""The type of --condition-seed."""
