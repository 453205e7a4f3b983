"""Messages that wait to be sent: a small file each, on the disk until the broker has it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bayesbl.results.atomic import replacing

_DIGITS = 12
_SUFFIX = ".json"


@dataclass(frozen=True, slots=True)
class Outbox:
    """A folder of messages, numbered in the order in which they are to be sent."""

    folder: Path

    def put(self, message: bytes) -> None:
        """Keep a message; it is on the disk when this returns.

        Raises
        ------
        OSError
            If the disk is full, or the folder cannot be written for another reason.
        """
        waiting = self.waiting()
        number = int(waiting[-1].stem) + 1 if waiting else 1
        with replacing(self.folder / f"{number:0{_DIGITS}d}{_SUFFIX}", durable=True) as file:
            file.write_bytes(message)

    def waiting(self) -> list[Path]:
        """All messages, the oldest first."""
        return sorted(self.folder.glob(f"{'[0-9]' * _DIGITS}{_SUFFIX}"))
