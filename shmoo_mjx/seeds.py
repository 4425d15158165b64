"""Seeds as users give them: one bounded kind for every command, and the border above which no training draws."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.options import option

__all__ = ["MAX_CONDITION_SEED", "MAX_SEED", "UNSEEN_SEED", "ConditionSeed", "Seed", "check_seed", "seed_of"]

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
    if not 0 <= seed <= highest:
        raise _refusal(name, str(seed), highest)
    return seed


def seed_of(name: str, text: str, highest: int = MAX_SEED) -> int:
    """The seed that the text says.

    Raises:
        ShmooError: it is no whole number from 0 to ``highest``; ``name`` says which option it was given to.
    """
    # int() also takes "1_000", " 7" and other scripts' digits, and refuses texts of thousands of digits by itself.
    if not (text.isascii() and text.isdigit() and len(text) <= 20):
        raise _refusal(name, text, highest)
    return check_seed(name, int(text), highest)


def _refusal(name: str, given: str, highest: int) -> ShmooError:
    shown = given if len(given) <= 40 else given[:40] + "..."
    return ShmooError(f"{name} {shown!r} must be a whole number from 0 to {highest}.")


Seed = Annotated[int, option(partial(seed_of, "--seed"), "SEED")]
"""The type of every --seed."""

ConditionSeed = Annotated[int, option(partial(seed_of, "--condition-seed", highest=MAX_CONDITION_SEED), "SEED")]
"""The type of --condition-seed."""
