"""What dealing with an object is made of: approach a face, make contact, push, retreat.

Each skill is ``init`` and ``step`` on a frozen state. The navigator, the pushing task, the sweeps' pushers and whoever
else moves an object string these together; a controller that pushes is their argument.
"""

from shmoo_mjx.behavior.skills import approach, contact, push, retreat
from shmoo_mjx.behavior.skills.settings import Move, batched, hold

__all__ = ["Move", "approach", "batched", "contact", "hold", "push", "retreat"]
