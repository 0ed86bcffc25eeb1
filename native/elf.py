"""Sizes of functions in an object file, for the report of a build."""

from __future__ import annotations

import struct


def sizes(code: bytes, names: list[str]) -> list[int]:
    """Bytes of machine code of each of these functions; 0 where the object is not in the format of
    Linux (ELF, 64 bit).

    Source: System V application binary interface, chapter 4.
    """
    if code[:5] != b"\x7fELF\x02":
        return [0] * len(names)
    (first,) = struct.unpack_from("<Q", code, 40)
    (each, count) = struct.unpack_from("<HH", code, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", code, first + k * each) for k in range(count)]
    (table,) = (s for s in sections if s[1] == 2)
    strings = sections[table[6]][4]
    found = {}
    for at in range(table[4], table[4] + table[5], table[9]):
        name, _, _, _, _, size = struct.unpack_from("<IBBHQQ", code, at)
        found[code[strings + name : code.index(b"\0", strings + name)].decode()] = size
    return [found.get(name, 0) for name in names]
