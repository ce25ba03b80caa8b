"""Damages files as users and transfers do, by seed: the same number gives the same damage on every machine."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass

NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?")
HUGE = (
    b"1e308", b"-1e308", b"1e999", b"1e-320", b"99999999999999999999", b"-2147483649", b"1e30", b"-1e30", b"1e15",
    b"0", b"-0.0", b"-1", b"4294967296", b"1.7976931348623157e308",
)  # fmt: skip
NO_NUMBERS = (b"nan", b"NaN", b"-nan", b"inf", b"-INF", b"Infinity", b"1..2", b"0x1F", b"1,5", "½".encode(), b"")
ENCODINGS = ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig", "utf-7", "cp500")
DEPTHS = (10, 300, 20_000)


@dataclass(frozen=True)
class Nest:
    """What makes a format deep: opened `before` some line that matches, closed after it, so many times."""

    before: bytes
    after: bytes
    line: bytes


Damage = Callable[[bytes, random.Random, Nest], bytes]


def cut(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """The end is missing, or a piece out of the middle."""
    a, b = sorted(rng.sample(range(len(data)), 2))
    return data[:a] if rng.random() < 0.5 else data[:a] + data[b:]


def double(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """A line or a block stands there several times."""
    lines = data.splitlines(keepends=True)
    k = rng.randrange(len(lines))
    count = rng.choice((1, 1, 5, 40))
    return b"".join([*lines[:k], *lines[k : k + count] * rng.choice((2, 2, 3, 200)), *lines[k + count :]])


def swap(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """Two lines, or two words of the file, have changed places."""
    parts = data.splitlines(keepends=True) if rng.random() < 0.5 else re.split(rb"(\s+)", data)
    i, j = rng.sample(range(len(parts)), 2)
    parts[i], parts[j] = parts[j], parts[i]
    return b"".join(parts)


def garble(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """Bytes are overwritten at random: one, some in many places, or a block."""
    made = bytearray(data)
    kind = rng.randrange(3)
    if kind == 0:
        made[rng.randrange(len(made))] = rng.randrange(256)
    elif kind == 1:
        for _ in range(rng.randrange(2, 40)):
            made[rng.randrange(len(made))] = rng.randrange(256)
    else:
        start = rng.randrange(len(made))
        made[start : start + 200] = rng.randbytes(min(200, len(made) - start))
    return bytes(made)


def replace_number(data: bytes, rng: random.Random, words: tuple[bytes, ...]) -> bytes:
    """One number, or one in ten, is another word."""
    found = list(NUMBER.finditer(data))
    chosen = [rng.choice(found)] if rng.random() < 0.7 else [match for match in found if rng.random() < 0.1]
    for match in reversed(chosen):
        data = data[: match.start()] + rng.choice(words) + data[match.end() :]
    return data


def huge(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """Numbers are too large, too small or negative."""
    return replace_number(data, rng, HUGE)


def no_number(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """Numbers are none: NaN, infinite, foreign spellings, nothing."""
    return replace_number(data, rng, NO_NUMBERS)


def recode(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """Another encoding, a second byte order mark, an odd byte, zero bytes."""
    kind = rng.randrange(4)
    if kind == 0:
        return data.decode("utf-8", "replace").encode(rng.choice(ENCODINGS))
    if kind == 1:
        return rng.choice((b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf\xef\xbb\xbf", b"\x00", b"\xff\xfe\x00\x00")) + data
    if kind == 2:
        at = rng.randrange(len(data))
        return data[:at] + rng.choice((b"\xe9", b"\xc3", b"\xf0\x9f", b"\x00", b"\x1a", b"\xa0")) + data[at:]
    return data.decode("utf-8", "replace").encode("utf-16")[: rng.randrange(3, 2 * len(data))]


def deepen(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """A line stands deep within others."""
    depth = rng.choice(DEPTHS)
    places = [match for match in re.finditer(nest.line, data, re.MULTILINE)]
    match = rng.choice(places)
    closed = nest.after * (depth if rng.random() < 0.7 else depth // 2)
    return data[: match.start()] + nest.before * depth + match[0] + closed + data[match.end() :]


DAMAGES: tuple[Damage, ...] = (cut, double, swap, garble, huge, no_number, recode, deepen)
