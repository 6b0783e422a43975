"""Snapshots: everything that determines the future of a swarm."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import cbor2
import msgspec

from ._atomic_file import atomic_file
from ._decode import read_map
from ._errors import Internal, InvalidArgument
from ._wire import EarlierModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """Everything that determines the future of a swarm; `Swarm.snapshot` and `load` make one.

        snapshot = jostle.Snapshot.load("school.snapshot")
        swarm = client.restore(snapshot, "school")

    `Client.restore` creates a swarm from it, on any daemon of the same `model_version` or a later
    one. Two snapshots are equal if their bytes are.

    Attributes:
        data: The bytes, CBOR, the same as in a file of `jostle snapshot`.
        swarm: The swarm's name.
        epoch: The epoch of the state.
        step: The step of the state.
        seq: Number of commands applied before.
        n: The size of the group.
        state_hash: BLAKE3 of the state, in hexadecimal.
        model_version: The version of the model: another one gives other results.
        earlier_models: The earlier versions of the model that computed steps before, oldest first.
    """

    data: bytes = field(repr=False)
    swarm: str
    epoch: int
    step: int
    seq: int
    n: int
    state_hash: str
    model_version: int
    earlier_models: tuple[EarlierModel, ...] = ()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Reads a snapshot.

        Raises:
            InvalidArgument: The bytes are not a snapshot, or not all of one.
        """
        wrong = {"field": "snapshot"}
        if not isinstance(data, bytes | bytearray | memoryview):
            raise InvalidArgument(
                f"not a snapshot: {type(data).__name__} instead of bytes", details=wrong
            )
        data = bytes(data)
        try:
            fields = cbor2.loads(data)
            # The daemon reads the other fields.
            own = {"data": data, "n": len(fields["id"].value) // 4}
            return msgspec.convert({**fields, **own}, cls)
        except (
            cbor2.CBORDecodeError,
            msgspec.ValidationError,
            ValueError,
            AttributeError,
            LookupError,
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

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Reads a snapshot from a file.

        Raises:
            OSError: It cannot be read.
            InvalidArgument: The file is not a snapshot, or not all of one.
        """
        return cls.from_bytes(Path(path).read_bytes())

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Writes it to a file, atomically.

        Args:
            path: The file.
            force: Replace an existing file.

        Returns:
            The file.

        Raises:
            FileExistsError: The file exists, and not `force`.
            OSError: It cannot be written.
        """
        path = Path(path)
        with atomic_file(path, force=force) as file:
            file.write(self.data)
        return path


def read_snapshot(payload: bytes) -> Snapshot:
    """Reads the reply to `get/snapshot`.

    Raises:
        Internal: It is not as the contract defines.
    """
    try:
        # All of its fields: a newer daemon may send more than this package knows.
        return Snapshot.from_bytes(cbor2.dumps(read_map(payload).get("result")))
    except InvalidArgument as error:
        raise Internal(f"the daemon sent a snapshot that cannot be read: {error}") from error
