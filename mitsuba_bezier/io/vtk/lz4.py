"""Decode LZ4 blocks, which VTK may use and Python's standard library lacks.

By hand, in forty lines: the package ``lz4`` would be one more to install for files that are rare
(VTK writes zlib by default), and the size of what comes out is bounded here before it is made.

Source: "LZ4 Block Format Description", https://github.com/lz4/lz4/blob/dev/doc/lz4_Block_format.md
"""

from __future__ import annotations

__all__ = ["decompress_block"]


def decompress_block(data: bytes, size: int) -> bytes:
    """Decode one LZ4 block.

    Parameters
    ----------
    data : bytes
        The block.
    size : int
        Its decoded size in bytes, known from elsewhere.

    Raises
    ------
    ValueError
        If the block is damaged or does not decode to `size` bytes.
    """
    out = bytearray()
    at, end = 0, len(data)

    def length(at: int, value: int) -> tuple[int, int]:
        if value == 15:
            while True:
                if at >= end:
                    raise ValueError("LZ4 block ends within a length")
                value += data[at]
                at += 1
                if data[at - 1] != 255:
                    break
        return at, value

    while at < end:
        token = data[at]
        at, literals = length(at + 1, token >> 4)
        if literals > end - at or len(out) + literals > size:
            raise ValueError("LZ4 literals run over the end")
        out += data[at : at + literals]
        at += literals
        if at == end:  # the last sequence has no match
            break
        if end - at < 2:
            raise ValueError("LZ4 block ends within an offset")
        distance = data[at] | data[at + 1] << 8
        at, match = length(at + 2, token & 15)
        match += 4
        start = len(out) - distance
        if distance == 0 or start < 0 or len(out) + match > size:
            raise ValueError("LZ4 match points outside of the block")
        if distance >= match:
            out += out[start : start + match]
        else:  # overlap: the last `distance` bytes repeat
            out += (bytes(out[start:]) * (match // distance + 1))[:match]
    if len(out) != size:
        raise ValueError(f"LZ4 block of {len(out)} bytes instead of {size}")
    return bytes(out)
