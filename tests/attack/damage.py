"""What can happen to the bytes of any file. A line here is a case in every group that uses it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

Damage = Callable[[bytes, np.random.Generator], bytes]


def _place(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data))) if data else 0


def _chunk(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    start = _place(data, rng)
    return start, min(len(data), start + int(rng.integers(1, max(2, len(data) // 4))))


def flip_bits(data: bytes, rng: np.random.Generator, count: int = 1) -> bytes:
    """Single bits, anywhere."""
    damaged = bytearray(data)
    for _ in range(count):
        damaged[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def flip_in_head(data: bytes, rng: np.random.Generator) -> bytes:
    """A byte among the first 512, where formats keep what they are."""
    damaged = bytearray(data)
    damaged[int(rng.integers(min(512, len(data))))] = int(rng.integers(256))
    return bytes(damaged)


def overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = _chunk(data, rng)
    return data[:start] + rng.bytes(end - start) + data[end:]


def delete(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = _chunk(data, rng)
    return data[:start] + data[end:]


def double(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = _chunk(data, rng)
    return data[:end] + data[start:]


def zero(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = _chunk(data, rng)
    return data[:start] + bytes(end - start) + data[end:]


def insert(data: bytes, rng: np.random.Generator) -> bytes:
    start = _place(data, rng)
    return data[:start] + rng.bytes(int(rng.integers(1, 64))) + data[start:]


def swap_chunks(data: bytes, rng: np.random.Generator) -> bytes:
    start, end = _chunk(data, rng)
    return data[end:] + data[start:end] + data[:start]


BYTES: Mapping[str, Damage] = {
    "a bit flipped": flip_bits,
    "another bit flipped": flip_bits,
    "ten bits flipped": lambda data, rng: flip_bits(data, rng, 10),
    "a byte of the head changed": flip_in_head,
    "cut short": lambda data, rng: data[: _place(data, rng)],
    "last byte missing": lambda data, rng: data[:-1],
    "only the first bytes": lambda data, rng: data[: int(rng.integers(1, 64))],
    "empty": lambda data, rng: b"",
    "beginning missing": lambda data, rng: data[_place(data, rng) :],
    "garbage written over": overwrite,
    "garbage put in": insert,
    "a chunk deleted": delete,
    "a chunk doubled": double,
    "a chunk of zeros": zero,
    "chunks exchanged": swap_chunks,
    "garbage after the end": lambda data, rng: data + rng.bytes(1000),
    "twice in a row": lambda data, rng: data + data,
    "all garbage": lambda data, rng: rng.bytes(max(16, len(data))),
    "all zeros": lambda data, rng: bytes(max(16, len(data))),
}
"""Name to what is done; each may change what the file says."""
