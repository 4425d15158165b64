"""Seeds as users give them: one bounded kind for every command, and the border above which no training draws."""

from __future__ import annotations

from typing import Annotated

from tyro.constructors import PrimitiveConstructorSpec

from shmoo_mjx.errors import ShmooError

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


def _option(name: str, highest: int) -> PrimitiveConstructorSpec[int]:
    # A ShmooError passes through tyro, which would make a page of a ValueError.
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="SEED",
        instance_from_str=lambda texts: seed_of(name, texts[0], highest),
        is_instance=lambda value: isinstance(value, int),
        str_from_instance=lambda seed: [str(seed)],
    )


Seed = Annotated[int, _option("--seed", MAX_SEED)]
"""The type of every --seed."""

ConditionSeed = Annotated[int, _option("--condition-seed", MAX_CONDITION_SEED)]
"""The type of --condition-seed."""
