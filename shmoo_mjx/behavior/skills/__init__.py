"""Skills for pushing an object: approach a face, make contact, push, retreat.

Each skill is ``init`` and ``step`` on a frozen state. The navigator, the push task and the sweeps' pushers combine
them. The pushing controller is an argument.
"""

from shmoo_mjx.behavior.skills import approach, contact, push, retreat
from shmoo_mjx.behavior.skills.settings import Move, batched, hold

__all__ = ["Move", "approach", "batched", "contact", "hold", "push", "retreat"]
