"""The one function of libatomic that Dr.Jit calls, for machines that have no libatomic.

The wheel of Dr.Jit is linked with libatomic.so.1, which no wheel brings and many distributions do not install. Dr.Jit
calls ``__atomic_compare_exchange_16`` of it, and libc++ of LLVM's wheel names the library without calling it. Where it
is missing, a library of this function alone is put together in memory and loaded under that name.
"""

from __future__ import annotations

import ctypes
import functools
import os
import platform
import struct
import sys

NAME = "libatomic.so.1"
FUNCTION = "__atomic_compare_exchange_16"
VERSION = "LIBATOMIC_1.0"  # of the function, by which Dr.Jit asks for it

# bool f(void *memory, void *expected, __int128 desired, int, int) of the System V ABI for x86-64: memory in rdi,
# expected in rsi, desired in rdx (low half) and rcx (high half)
_CODE = bytes.fromhex(
    "53"  # push rbx
    "4889d3"  # mov rbx, rdx
    "488b06"  # mov rax, [rsi]
    "488b5608"  # mov rdx, [rsi + 8]
    "f0480fc70f"  # lock cmpxchg16b [rdi]
    "7407"  # je over the next two
    "488906"  # mov [rsi], rax
    "48895608"  # mov [rsi + 8], rdx
    "0f94c0"  # sete al; mov changes no flags
    "5b"  # pop rbx
    "c3"  # ret
)


def on_linux_x86_64() -> bool:
    """True if this is a 64-bit Python on Linux and an x86-64 processor, for which there are wheels of libLLVM."""
    return sys.platform == "linux" and platform.machine() == "x86_64" and sys.maxsize > 1 << 32


@functools.cache
def provide_libatomic() -> str | None:
    """
    Load libatomic, or a stand-in for it, before Dr.Jit asks for it.

    Returns
    -------
    str or None
        Path under which this process and its children find the stand-in, as long as this process lives; None if the
        machine has a libatomic, is not Linux on x86-64, or runs no code from memory.
    """
    if not on_linux_x86_64():
        return None
    try:
        ctypes.CDLL(NAME)
        return None
    except OSError:
        pass
    try:
        file = os.memfd_create(NAME)
        os.write(file, library())
        path = f"/proc/{os.getpid()}/fd/{file}"
        ctypes.CDLL(path)
        return path
    except OSError:  # a kernel that runs no code from memory; the import of Mitsuba then says what to install
        return None


def library() -> bytes:
    """
    Return an ELF library for x86-64 that defines `FUNCTION` of version `VERSION`, and is called `NAME`.

    The format is that of the System V ABI, chapters 4 and 5, with the symbol versions of the Linux Standard Base.
    """
    names = b"\0" + b"".join(text.encode() + b"\0" for text in (NAME, FUNCTION, VERSION))
    name, function, version = (names.index(text.encode()) for text in (NAME, FUNCTION, VERSION))
    symbol_bytes, page = 24, 0x1000
    start = 64 + 4 * 56  # behind the header and the four segments
    symbols_at, names_at = start, start + 2 * symbol_bytes
    table_at = _aligned(names_at + len(names))
    versions_at = table_at + 5 * 4
    defined_at = _aligned(versions_at + 2 * 2)
    code_at = _aligned(defined_at + 2 * 28)
    end = code_at + len(_CODE)
    symbols = bytes(symbol_bytes) + struct.pack("<IBBHQQ", function, 0x12, 0, 1, code_at, len(_CODE))  # global function
    table = struct.pack("<5I", 1, 2, 1, 0, 0)  # one bucket, two symbols: the bucket begins and ends with the second
    versions = struct.pack("<2H", 0, 2)
    defined = _definition(1, name, NAME, 28) + _definition(2, version, VERSION, 0)  # the first one is of the file
    entries = [
        (14, name), (4, table_at), (5, names_at), (6, symbols_at), (10, len(names)), (11, symbol_bytes),
        (0x6FFFFFF0, versions_at), (0x6FFFFFFC, defined_at), (0x6FFFFFFD, 2), (0, 0),
    ]  # fmt: skip
    dynamic = b"".join(struct.pack("<2Q", *entry) for entry in entries)
    read, write, execute = 4, 2, 1
    segments = (
        (1, read | execute, 0, end, page),
        (1, read | write, page, len(dynamic), page),  # the loader writes addresses into it
        (2, read | write, page, len(dynamic), 8),
        (0x6474E551, read | write, 0, 0, 16),  # a stack that runs no code
    )
    header = struct.pack("<16s2HI3QI6H", b"\x7fELF\2\1\1", 3, 62, 1, 0, 64, 0, 0, 64, 56, len(segments), 0, 0, 0)
    headers = header + b"".join(
        struct.pack("<2I6Q", kind, rights, at, at, at, size, size, alignment)
        for kind, rights, at, size, alignment in segments
    )
    parts = {
        0: headers, symbols_at: symbols, names_at: names, table_at: table, versions_at: versions,
        defined_at: defined, code_at: _CODE, page: dynamic,
    }  # fmt: skip
    made = bytearray(page + len(dynamic))
    for at, part in parts.items():
        made[at : at + len(part)] = part
    return bytes(made)


def _aligned(offset: int) -> int:
    return -(-offset // 16) * 16


def _definition(number: int, name_at: int, name: str, to_next: int) -> bytes:
    """
    Return an ELF version definition; number 1 is that of the file itself.

    `name_at` is the byte offset of the name in the string table, `to_next` that from this definition to the next, 0 for
    the last.
    """
    return struct.pack("<4H3I2I", 1, int(number == 1), number, 1, _hash(name), 20, to_next, name_at, 0)


def _hash(name: str) -> int:
    """Return the System V ABI hash of a symbol name."""
    value = 0
    for letter in name.encode():
        value = (value << 4) + letter
        high = value & 0xF0000000
        value = (value ^ high >> 24) & ~high
    return value
