"""Snapshots: a swarm with all that its future depends on, as it can be kept in a file."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import cbor2
import msgspec

from ._atomic_file import atomic_file
from ._errors import Internal, InvalidArgument
from ._reading import read_map


class _Head(msgspec.Struct, frozen=True, kw_only=True):
    """What is read of a snapshot here; the rest is the daemon's."""

    swarm: str
    epoch: int
    step: int
    seq: int
    state_hash: str
    model_version: int
    id: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """A swarm with all that its future depends on; `Swarm.snapshot` and `load` make one.

    `Client.restore` makes a swarm of it, on any daemon of the same `model_version`. Two snapshots
    are equal if every byte of them is.

    Attributes:
        data: The bytes: CBOR, the same as in a file that `jostle snapshot` wrote.
        swarm: The swarm's name.
        epoch: Its epoch.
        step: The step it is at.
        seq: How many commands it had applied.
        n: The size of the group.
        state_hash: BLAKE3 of the state, in hexadecimal.
        model_version: The version of the model that steps it: another one has another future.
    """

    data: bytes = field(repr=False)
    swarm: str
    epoch: int
    step: int
    seq: int
    n: int
    state_hash: str
    model_version: int

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Reads a snapshot.

        Raises:
            InvalidArgument: These bytes are none, or not all of it.
        """
        wrong = {"field": "snapshot"}
        if not isinstance(data, bytes | bytearray | memoryview):
            raise InvalidArgument(
                f"not a snapshot: {type(data).__name__} instead of bytes", details=wrong
            )
        data = bytes(data)
        try:
            fields = cbor2.loads(data)
            head = msgspec.convert(fields, _Head)
            n = len(head.id.value) // 4
        except (
            cbor2.CBORDecodeError,
            msgspec.ValidationError,
            ValueError,
            AttributeError,
            TypeError,
            OverflowError,
            MemoryError,
            RecursionError,
        ) as error:
            raise InvalidArgument(
                f"not a snapshot, or not all of one ({error}): `Swarm.snapshot` and "
                "`jostle snapshot` make one",
                details=wrong,
            ) from error
        return cls(
            data=data,
            swarm=head.swarm,
            epoch=head.epoch,
            step=head.step,
            seq=head.seq,
            n=n,
            state_hash=head.state_hash,
            model_version=head.model_version,
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Reads a snapshot from a file.

        Raises:
            OSError: It cannot be read.
            InvalidArgument: It is no snapshot, or not all of one.
        """
        return cls.from_bytes(Path(path).read_bytes())

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Writes it to a file, all of it or nothing.

        Args:
            path: The file.
            force: Replace a file that is there.

        Returns:
            The file.

        Raises:
            FileExistsError: It is there already, and not `force`.
            OSError: It cannot be written.
        """
        path = Path(path)
        with atomic_file(path, force=force) as file:
            file.write(self.data)
        return path


def read_snapshot(payload: bytes) -> Snapshot:
    """Reads the answer to `get/snapshot`.

    Raises:
        Internal: It is not what the contract says.
    """
    try:
        # As it came: a newer daemon may tell more than is known here.
        return Snapshot.from_bytes(cbor2.dumps(read_map(payload).get("result")))
    except InvalidArgument as error:
        raise Internal(f"the daemon sent a snapshot that cannot be read: {error}") from error
