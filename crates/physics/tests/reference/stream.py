"""The random streams of `src/model/random.rs`: ChaCha8.

The key is (seed, occasion, individual, purpose). This implementation is independent of the Rust
one.
"""

import math
import struct
from collections.abc import Iterator

NOISE_PURPOSE = 4
ROUNDS = 8
WORD = 0xFFFFFFFF


def keystream_block(key: bytes, counter: int) -> bytes:
    """Returns 64 bytes of ChaCha8 in the IETF layout: a 32-bit counter and a nonce of zeros."""
    start = [
        *struct.unpack("<4I", b"expand 32-byte k"),
        *struct.unpack("<8I", key),
        counter,
        0,
        0,
        0,
    ]
    words = list(start)
    for _ in range(ROUNDS // 2):
        for column in range(4):
            _quarter_round(words, [column + 4 * row for row in range(4)])
        for diagonal in range(4):
            _quarter_round(words, [(diagonal + row) % 4 + 4 * row for row in range(4)])
    return struct.pack("<16I", *((a + b) & WORD for a, b in zip(words, start, strict=True)))


def bits(seed: int, occasion: int, individual: int, purpose: int) -> Iterator[int]:
    """Yields the 64-bit words of one stream, without end."""
    key = struct.pack("<4Q", seed, occasion, individual, purpose)
    counter = 0
    while True:
        yield from struct.unpack("<8Q", keystream_block(key, counter))
        counter += 1


def standard_normal(seed: int, step: int, individual: int) -> float:
    """Returns the noise of one individual in one step: two uniforms, Box-Muller."""
    words = bits(seed, step, individual, NOISE_PURPOSE)
    first, second = _uniform(next(words)), _uniform(next(words))
    # The uniform is in [0, 1), so 1 - first is not 0 and the logarithm is finite.
    return math.sqrt(-2.0 * math.log(1.0 - first)) * math.cos(2.0 * math.pi * second)


def _uniform(word: int) -> float:
    return (word >> 11) / (1 << 53)


def _quarter_round(words: list[int], at: list[int]) -> None:
    a, b, c, d = at
    for target, source, turned, shift in ((a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)):
        words[target] = (words[target] + words[source]) & WORD
        mixed = words[turned] ^ words[target]
        words[turned] = ((mixed << shift) | (mixed >> (32 - shift))) & WORD
