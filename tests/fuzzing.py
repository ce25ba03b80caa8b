"""Damages files as users and transfers do, by seed: the same number gives the same damage on every machine."""

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?")
HUGE = (
    b"1e308", b"-1e308", b"1e999", b"1e-320", b"99999999999999999999", b"-2147483649", b"1e30", b"-1e30", b"1e15",
    b"0", b"-0.0", b"-1", b"4294967296", b"1.7976931348623157e308",
)  # fmt: skip
NO_NUMBERS = (b"nan", b"NaN", b"-nan", b"inf", b"-INF", b"Infinity", b"1..2", b"0x1F", b"1,5", "½".encode(), b"")
ENCODINGS = ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig", "utf-7", "cp500")
LONGEST = 600  # characters of a clear line


@dataclass(frozen=True)
class Nest:
    """What makes a format deep: opened `before` some line that matches, closed after it, so many times."""

    before: bytes
    after: bytes
    line: bytes


def unclear(text: str) -> str | None:
    """What is wrong with a message; None if it is one line that says what is wrong and what to do."""
    if not text.isprintable() or len(text) > LONGEST:
        return f"{len(text.splitlines())} lines, {len(text)} characters: {text[:200]!r}"
    if "Traceback" in text or ".cpp:" in text:
        return f"the inside of a program: {text!r}"
    return None if re.search(r"\S; \S|: .*give |: .* must ", text) else f"no clear line: {text!r}"


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
    depth = rng.choice((10, 300, 20_000))
    match = rng.choice(list(re.finditer(nest.line, data, re.MULTILINE)))
    closed = nest.after * (depth if rng.random() < 0.7 else depth // 2)
    return data[: match.start()] + nest.before * depth + match[0] + closed + data[match.end() :]


DAMAGES: tuple[Damage, ...] = (cut, double, swap, garble, huge, no_number, recode, deepen)

# ---- damages that know the format of a scene; `write_companions` makes the files that they refer to

COMPANIONS = ("empty.xml", "folder.xml", "cycle.xml", "cycle_back.xml", "piece.xml", "missing.xml", ".", "/", "")
VALUES = ("float", "integer", "string", "boolean", "point", "vector", "rgb", "spectrum", "transform", "ref")
OBJECTS = ("shape", "bsdf", "emitter", "sensor", "film", "integrator", "scene", "texture", "include", "default")
PLUGINS = (
    "asphere", "frustum", "interface", "thinfilm", "abg", "paint", "collimated", "irradiancemeter", "hdrfilm",
    "straylight", "rectangle", "sphere", "obj", "diffuse", "perspective", "path", "bitmap", "asfere", "target", "",
)  # fmt: skip
STRINGS = (
    b"", b" ", b"true", b"1", b"1, 2", b"1 2 3 4", b"$x", b"N-BK8", b"../../etc/passwd", "Glas ß".encode(), b"a" * 5000,
)  # fmt: skip


def write_companions(folder: Path) -> None:
    """An empty file, a folder, two files that include each other, and a piece of a scene."""
    (folder / "empty.xml").write_bytes(b"")
    (folder / "folder.xml").mkdir(exist_ok=True)
    for name, other in (("cycle", "cycle_back"), ("cycle_back", "cycle")):
        text = f'<scene version="3.0.0"><include filename="{other}.xml"/></scene>'
        (folder / f"{name}.xml").write_text(text, encoding="utf-8")
    (folder / "piece.xml").write_text('<scene version="3.0.0"><default name="x" value="1"/></scene>', encoding="utf-8")


def _one(pattern: bytes, data: bytes, rng: random.Random) -> re.Match[bytes]:
    return rng.choice(list(re.finditer(pattern, data, re.DOTALL)))


def _instead(match: re.Match[bytes], new: bytes, data: bytes, group: int = 0) -> bytes:
    return data[: match.start(group)] + new + data[match.end(group) :]


def retype(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """A value is of another type or text, an object of another kind, an attribute has another name."""
    kind = rng.randrange(5)
    if kind == 0:
        return _instead(_one(rb"<(float|integer|string|boolean) ", data, rng), rng.choice(VALUES).encode(), data, 1)
    if kind == 1:
        return _instead(_one(rb'type="([^"]*)"', data, rng), rng.choice(PLUGINS).encode(), data, 1)
    if kind == 2:
        return _instead(_one(rb' value="([^"]*)"', data, rng), rng.choice(STRINGS), data, 1)
    if kind == 3:
        return _instead(_one(rb' (name|value|type|id)="', data, rng), rng.choice((b"name", b"value", b"x")), data, 1)
    found = _one(rb"<(shape|bsdf|sensor|film|emitter)\b.*?</(\1)>", data, rng)
    new = rng.choice(OBJECTS).encode()
    return _instead(found, found[0].replace(b"<" + found[1], b"<" + new).replace(found[1] + b">", new + b">"), data)


def rename(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """Two objects have the same id, two parameters of an object the same name, or a parameter an unknown one."""
    what = rng.choice((b"id", b"name"))
    names = re.findall(b" " + what + rb'="([^"]*)"', data)
    new = rng.choice([*names, b"", b"x", b"to_world", b"type", b"id", "höhe".encode(), b"a.b", b"_x"])
    return _instead(_one(b" " + what + rb'="([^"]*)"', data, rng), new, data, 1)


def refer(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """References to what is not there, to what is of another kind, to itself, or around in a circle."""
    ids = re.findall(rb' id="([^"]*)"', data)
    at = _one(rb"<bsdf [^>]*>", data, rng).end() if rng.random() < 0.7 else _one(rb"<shape [^>]*>", data, rng).end()
    circle = b'<bsdf type="interface" id="p"><ref id="q"/></bsdf><bsdf type="interface" id="q"><ref id="p"/></bsdf>'
    loop = b'<bsdf type="interface" id="p"><ref id="p"/></bsdf>'
    nested, before = rng.choice(
        [(b'<ref id="p"/>', circle), (b'<ref id="p"/>', loop), (b'<ref id="p" name="coating"/>', circle)]
        + [(b'<ref id="' + rng.choice([*ids, b"nobody", b""]) + b'"/>', b"") for _ in range(5)]
        + [(b"<ref/>", b""), (b'<ref name="bsdf"/>', b"")]
    )
    start = _one(rb"<shape ", data, random.Random(0)).start()
    return data[:start] + before + data[start:at] + nested + data[at:]


def expand(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """Entities: a bomb, a file of the machine, themselves, what is not declared; parameters that name each other."""
    many = b"".join(b'<!ENTITY e%d "%s">' % (k + 1, b"&e%d;" % k * 20) for k in range(8))
    square = b'<!ENTITY e8 "%s">' % (b"9" * 50_000)
    kinds = (
        b'<!ENTITY e0 "1">' + many,
        square,
        b'<!ENTITY e8 SYSTEM "file:///etc/passwd">',
        b'<!ENTITY e8 SYSTEM "folder.xml">',
        b'<!ENTITY e8 "&e8;">',
        b'<!ENTITY % p SYSTEM "missing.dtd"> %p;',
        b"",
    )
    kind = rng.choice(kinds)
    count = 2000 if kind is square else 1
    data = _instead(_one(rb' value="([^"]*)"', data, rng), b"&e8;" * count, data, 1)
    if rng.random() < 0.3:
        text = b'<default name="x" value="$y"/><default name="y" value="$x"/>'
        data = re.sub(rb"(<scene[^>]*>)", rb"\1" + text, data).replace(b"&e8;", b"$x")
    at = data.index(b"<scene")
    return data[:at] + b"<!DOCTYPE scene [" + kind + b"]>" + data[at:] if kind else data


def misfile(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """References to files that are folders, empty, missing, no tables, or the scene itself."""
    name = rng.choice(
        (*COMPANIONS, "SELF", "/dev/null", "a" * 300 + ".csv", "piece.xml:X", "\\\\host\\x", "folder.xml/x.csv")
    )
    value = b'value="' + name.encode() + b'"/>'
    kind = rng.randrange(5)
    if kind == 0:
        return _instead(_one(rb"<bsdf [^>]*>(.*?)</bsdf>", data, rng), b'<string name="table" ' + value, data, 1)
    if kind == 1:
        at = _one(rb"</bsdf>", data, rng).start()
        return data[:at] + b'<bsdf type="thinfilm"><string name="table" ' + value + b"</bsdf>" + data[at:]
    if kind == 2:
        found = _one(rb'<string name="(?:back|front)" value="([^"]*)"', data + b'<string name="front" value=""', rng)
        return _instead(found, name.encode(), data, 1) if found.end() <= len(data) else data
    if kind == 3:
        at = _one(rb"</bsdf>", data, rng).start()
        return data[:at] + b'<bsdf type="tabulated"><string name="file" ' + value + b"</bsdf>" + data[at:]
    shape = rng.choice((b"part_mesh", b"obj", b"ply"))
    at = data.index(b"</scene>")
    return data[:at] + b'<shape type="' + shape + b'"><string name="filename" ' + value + b"</shape>" + data[at:]


def include(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    """Includes of itself, of files that include each other, of folders and of what is no scene; or many times."""
    alone = [[name] for name in (*COMPANIONS, "SELF", "/etc/passwd", "/dev/null")]
    names = rng.choice([*alone, ["piece.xml"] * 200])
    at = rng.choice([match.end() for match in re.finditer(rb"<(?:scene|shape|bsdf)\b[^>]*>", data)])
    return data[:at] + b"".join(b'<include filename="' + name.encode() + b'"/>' for name in names) + data[at:]


def blank(data: bytes, rng: random.Random, nest: Nest) -> bytes:
    kinds = (
        b"", b" ", b"\n\n", b"\xef\xbb\xbf", b"\x00", b"<", b"<scene", b"<scene/>", b'<scene version="3.0.0"/>',
        b"<!-- -->", b"<?xml version='1.0'?>", b"<html><body/></html>", b"{}",
        b"\x89PNG\r\n\x1a\n", b'<scene version="x"></scene>',
        b'<scene version="99.0.0"></scene>', b'<shape type="asphere"/>', b'<scene version="0.1.0"><a/></scene>',
    )  # fmt: skip
    if rng.random() < 0.5:
        return rng.choice(kinds)
    found = _one(rb"<(shape|bsdf|emitter|sensor|film)\b[^>]*>(.*?)</\1>", data, rng)
    return _instead(found, b"", data, rng.choice((0, 2)))


XML_DAMAGES: tuple[Damage, ...] = (*DAMAGES, retype, rename, refer, expand, misfile, include, blank)
