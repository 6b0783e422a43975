"""Checksums of files, compared before a library parses their bytes.

The libraries trust what they parse: a flipped bit can come back as another value. Parquet files of
jostle have the metadata key `jostle.blake3` with the text `footer:HASH END:HASH END:HASH …`: a hash
for each row group, whose bytes go from the end of the one before it, or from the beginning of the
file, to END; and one over the bytes after the last row group, with its own digits as zeros. MCAP
has a checksum over its data, and one over its summary.
"""

from __future__ import annotations

import contextlib
import errno
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ._errors import Internal, InvalidArgument, invalid
from ._extras import import_extra

_PIECE_BYTES = 1 << 20

_PARQUET = b"PAR1"
_DIGITS = 64

CHECKSUMS = "jostle.blake3"
"""The metadata key of the checksums of a Parquet file."""

# The key in its encoding within the footer, and what its text begins with.
_KEY = b"\x18\x0d" + CHECKSUMS.encode() + b"\x18"
_TEXT = re.compile(rb"footer:[0-9a-f]{64}(?: \d+:[0-9a-f]{64})*")
_START = re.compile(rb"footer:[0-9a-fA-F]{64}")

# What the footer calls the writers of jostle, after the metadata.
_WRITERS = (b"parquet-rs version ", b"jostle-results ")

# What libraries raise for a damaged file, whose lengths can be anything.
_DAMAGED = (
    *(ValueError, LookupError, OSError, EOFError, ArithmeticError, MemoryError),
    *(RuntimeError, struct.error, Internal),
)
_LIBRARIES = ("mcap", "pyarrow", "zstandard")

# MCAP's magic, its records, and the length of the checksum that ends a data end and a footer.
_MCAP = b"\x89MCAP0\r\n"
_FOOTER, _DATA_END = 0x02, 0x0F
_CRC_BYTES = 4


@dataclass(frozen=True, slots=True)
class _Group:
    """The bytes of a row group, and their hash."""

    begin: int
    end: int
    hash: str


class ParquetChecksums:
    """The checksums of an open Parquet file, whose footer is checked here.

    A file of an earlier version, or of another program, has none: nothing is checked.

    Args:
        file: The file.
        extra: The extra of this package that has what hashes it.

    Raises:
        ImportError: blake3 is missing.
        ValueError: The footer is damaged.
    """

    def __init__(self, file: IO[bytes], extra: str) -> None:
        self._file = file
        self._extra = extra
        self._groups: list[_Group] = []
        length = file.seek(0, 2)
        last = _read(file, max(0, length - 8), length)
        (footer_bytes,) = struct.unpack("<I", last[:4]) if len(last) == 8 else (0,)
        begin = length - 8 - footer_bytes
        if last[4:] != _PARQUET or begin < 0:
            # The library says that it is not Parquet.
            return
        footer = _read(file, begin, length - 8)
        at = footer.rfind(_KEY)
        if at < 0:
            # Even if a bit of the key is flipped, its text is there.
            if _START.search(footer):
                raise _problem("the key of its checksums is damaged")
            return
        # Other programs copy the metadata of a table to a file that they write, whose bytes differ.
        if not any(writer in footer[at:] for writer in _WRITERS):
            return
        # A length precedes the text; its last byte is below 128.
        at += len(_KEY)
        while footer[at : at + 1] >= b"\x80":
            at += 1
        text = _TEXT.match(footer, at + 1)
        if text is None:
            raise _problem("the text of its checksums is damaged")
        own, *groups = text[0].decode().split(" ")
        end = 0
        for group in groups:
            next_end, hash_ = group.split(":")
            if not end < int(next_end) <= begin:
                raise _problem("the text of its checksums is damaged")
            self._groups.append(_Group(end, int(next_end), hash_))
            end = int(next_end)
        digits = begin + text.start() + len("footer:")
        self._check(_Group(end, length, own.removeprefix("footer:")), digits)

    def check_group(self, index: int) -> None:
        """Checks a row group.

        Raises:
            ValueError: It is damaged.
        """
        if self._groups:
            self._check(self._groups[index])

    def check_all(self) -> None:
        """Checks all row groups.

        Raises:
            ValueError: One is damaged.
        """
        for group in self._groups:
            self._check(group)

    def _check(self, group: _Group, digits: int | None = None) -> None:
        """Compares the hash of bytes, those of the `digits` as zeros."""
        hasher = import_extra("blake3", self._extra).blake3()
        if digits is None:
            self._update(hasher, group.begin, group.end)
        else:
            self._update(hasher, group.begin, digits)
            hasher.update(b"0" * _DIGITS)
            self._update(hasher, digits + _DIGITS, group.end)
        if hasher.hexdigest() != group.hash:
            raise _problem(
                f"its bytes from {group.begin} to {group.end} do not match their checksum"
            )

    def _update(self, hasher: object, begin: int, end: int) -> None:
        for at in range(begin, end, _PIECE_BYTES):
            hasher.update(_read(self._file, at, min(at + _PIECE_BYTES, end)))  # type: ignore[attr-defined]


def check_mcap(file: IO[bytes]) -> None:
    """Compares the checksums of all bytes of an MCAP file; one that is 0 is not there.

    Raises:
        ValueError: It is no MCAP file, cut short or damaged.
    """
    magic = _exactly(file, len(_MCAP))
    if magic != _MCAP:
        raise ValueError("it is no MCAP file")
    crc = zlib.crc32(magic)
    has_data_end = False
    while True:
        head = _exactly(file, 9)
        code, length = struct.unpack("<BQ", head)
        if code not in (_DATA_END, _FOOTER):
            crc = _crc_of(file, length, zlib.crc32(head, crc))
            continue
        body = _exactly(file, min(length, _PIECE_BYTES))
        if code == _FOOTER:
            crc = zlib.crc32(body[:-_CRC_BYTES], zlib.crc32(head, crc))
        stored = int.from_bytes(body[-_CRC_BYTES:], "little")
        if len(body) != length or stored not in (0, crc):
            raise _problem("a checksum is wrong")
        if code == _FOOTER:
            if not has_data_end or _exactly(file, len(_MCAP)) != _MCAP:
                raise _problem("its end is not the end of an MCAP file")
            return
        crc, has_data_end = 0, True


def _crc_of(file: IO[bytes], length: int, crc: int) -> int:
    """Adds bytes to a checksum."""
    while length > 0:
        piece = _exactly(file, min(length, _PIECE_BYTES))
        crc = zlib.crc32(piece, crc)
        length -= len(piece)
    return crc


def _exactly(file: IO[bytes], length: int) -> bytes:
    piece = file.read(length)
    if len(piece) < length:
        raise _problem("it is cut short")
    return piece


def _read(file: IO[bytes], begin: int, end: int) -> bytes:
    file.seek(begin)
    return file.read(end - begin)


def _problem(problem: str) -> ValueError:
    return ValueError(f"{problem}: copy the file again, or restore it from a backup")


@contextlib.contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Raises InvalidArgument with the file's name, and its kind, if a library cannot read it."""
    try:
        yield
    except (ImportError, InvalidArgument):
        raise
    except Exception as error:
        # An OSError without a number is pyarrow's; EINVAL is that of a seek before the beginning.
        is_of_system = isinstance(error, OSError) and error.errno not in (None, errno.EINVAL)
        is_expected = isinstance(error, _DAMAGED) or type(error).__module__.startswith(_LIBRARIES)
        if is_of_system or not is_expected:
            raise
        raise damaged(path, what, str(error)) from error


def damaged(path: Path, what: str, problem: str) -> InvalidArgument:
    """The error of a file that cannot be read."""
    return invalid("path", f"{path}: not a complete {what}: {problem}")
