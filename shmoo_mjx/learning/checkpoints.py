"""Checkpoints of a training with orbax, from which an interrupted training resumes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from shmoo_mjx.errors import ShmooError

Tree = Any


class Checkpoints:
    """The latest checkpoint of one training in a directory. Checkpoints of other trainings in it are deleted.

    Args:
        directory: directory of the checkpoint; created if it does not exist.
        identity: fingerprint of everything that determines the training (`shmoo_mjx.base.fingerprints`).
    """

    def __init__(self, directory: Path, identity: str) -> None:
        # Imported here because the import takes a second.
        import orbax.checkpoint as ocp

        self._args, self._identity, self._directory = ocp.args, identity, directory
        options = ocp.CheckpointManagerOptions(
            max_to_keep=1, cleanup_tmp_directories=True, enable_async_checkpointing=False
        )
        with self._explained("read"):
            self._manager = ocp.CheckpointManager(directory.resolve(), options=options)

    def load(self, like: Tree) -> tuple[Tree, dict[str, Any]] | None:
        """The saved state, in the structure of ``like``, and its notes; None if this training saved none.

        Raises:
            ShmooError: the checkpoint is damaged.
        """
        with self._explained("read"):
            step = self._manager.latest_step()
            if step is None:
                return None
            notes = self._manager.restore(step, args=self._args.Composite(notes=self._args.JsonRestore()))["notes"]
            if notes["identity"] != self._identity:
                for other in self._manager.all_steps():
                    self._manager.delete(other)
                return None
            parts = self._args.Composite(tree=self._args.StandardRestore(like))
            return self._manager.restore(step, args=parts)["tree"], notes

    def save(self, step: int, tree: Tree, notes: dict[str, Any]) -> None:
        """Replace the checkpoint with the state after ``step``, atomically.

        Raises:
            ShmooError: the checkpoint can't be written.
        """
        notes = notes | {"identity": self._identity}
        parts = self._args.Composite(tree=self._args.StandardSave(tree), notes=self._args.JsonSave(notes))
        with self._explained("written"):
            self._manager.save(step, args=parts)

    def close(self) -> None:
        """Stop the threads of orbax."""
        self._manager.close()

    @contextmanager
    def _explained(self, what: str) -> Iterator[None]:
        try:
            yield
        except (ValueError, KeyError, TypeError, OSError) as error:
            reason = str(error).splitlines()[0][:200]
            remedy = "delete the folder to train anew" if what == "read" else "look for space and permissions"
            raise ShmooError(
                f"{self._directory}: the training's checkpoint can't be {what} ({reason}); {remedy}."
            ) from None
