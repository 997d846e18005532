"""Changes of files below their container: a TIFF keeps its directory, a PNG its check sums, a JPEG its segments, JSON its brackets.

Bytes changed at random are refused by the first check of a container, and what lies behind it is never read. These changes get there.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from random import Random

Mutate = Callable[[Random, bytes], bytes]

ODD_INTEGERS = (
    0,
    1,
    2,
    3,
    7,
    127,
    128,
    255,
    256,
    32767,
    32768,
    65535,
    65536,
    2**31 - 1,
    2**31,
    2 * 10**9,
    2**32 - 1,
    2**63,
    2**64 - 1,
)
_TIFF_TAGS = (*range(254, 260), 262, 273, 274, 277, 278, 279, 284, 317, *range(322, 326), 339, 33550, 34665, 34853, 42113)
_SIZES = (0, 1, 7, 63, 65, 4096, 65535, 200_000, 2**31 - 1, 2**32 - 1)
ODD_FLOATS = (0.0, -0.0, 1e-320, 1e-30, -1.0, 1e9, 3.4e38, -3.4e38, 1e300, float("nan"), float("inf"), float("-inf"))


def of_bytes(rng: Random, data: bytes) -> bytes:
    """One to four edits anywhere."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        data = _edited(rng, data)
    return data


def _edited(rng: Random, data: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    end = min(len(data), at + rng.choice((1, 2, 4, 8, 16, 100)))
    order, kind = rng.choice("<>"), rng.choice(("B", "H", "I", "Q", "f", "d"))
    match rng.randrange(7):
        case 0:
            return data[:at]
        case 1:
            return data[:at] + data[end:]
        case 2:
            return data[:end] + data[at:]
        case 3:
            return data[:at] + rng.randbytes(end - at) + data[end:]
        case 4 if at < len(data):
            return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
        case 5:
            return data[:at] + rng.randbytes(rng.choice((1, 4, 64))) + data[at:]
    return _with(data, min(at, max(0, len(data) - 8)), _number(rng, order, kind))


def _number(rng: Random, order: str, kind: str) -> bytes:
    size = struct.calcsize(kind)
    if kind in "fd":
        value = rng.choice(ODD_FLOATS)
        return struct.pack(order + kind, 3.4e38 if kind == "f" and value == 1e300 else value)
    return struct.pack(order + kind, rng.choice(ODD_INTEGERS) % 256**size)


def _with(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


def of_numbers(rng: Random, data: bytes) -> bytes:
    """An odd number at an aligned place, as the fields of binary records are; now and then any edit."""
    if rng.random() < 0.3 or len(data) < 8:
        return of_bytes(rng, data)
    for _ in range(rng.choice((1, 1, 2))):
        kind = rng.choice(("B", "H", "I", "Q", "f", "d"))
        at = rng.randrange(max(1, min(len(data) - 7, rng.choice((64, 400, 10**9)))))
        data = _with(data, at, _number(rng, rng.choice("<<<>"), kind))
    return data


def of_tiff(rng: Random, data: bytes) -> bytes:
    """Tags, types, counts and values of the first directory, and its place."""
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None or rng.random() < 0.15:
        return of_bytes(rng, data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        if len(data) < 14:
            return data
        start = struct.unpack_from(order + "I", data, 4)[0]
        if start + 14 > len(data):
            return of_bytes(rng, data)
        entries = min(struct.unpack_from(order + "H", data, start)[0], (len(data) - start - 2) // 12)
        at = start + 2 + 12 * rng.randrange(max(1, entries))
        match rng.randrange(8):
            case 0:
                data = _with(data, at, struct.pack(order + "H", rng.choice(_TIFF_TAGS)))
            case 1:
                data = _with(data, at + 2, struct.pack(order + "H", rng.randrange(20)))
            case 2:
                data = _with(data, at + 4, _number(rng, order, "I"))
            case 3 | 4:
                data = _with(data, at + 8, _number(rng, order, rng.choice("HI")))
            case 5:
                data = _with(data, at + 8, struct.pack(order + "H", rng.randrange(40)))
            case 6:  # the next directory, perhaps this one again
                data = _with(data, start + 2 + 12 * entries, struct.pack(order + "I", rng.choice((start, 0, 8, 2**32 - 1))))
            case _:
                data = _with(data, start, _number(rng, order, "H"))
    return data


def of_png(rng: Random, data: bytes) -> bytes:
    """Chunks: their fields, order and number. The check sums are right."""
    chunks = _png_chunks(data)
    if not chunks or rng.random() < 0.1:
        return of_bytes(rng, data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        i = rng.randrange(len(chunks))
        kind, body = chunks[i]
        match rng.randrange(9):
            case 0:
                chunks[i] = kind, of_bytes(rng, body)
            case 1:
                del chunks[i]
            case 2:
                chunks.insert(rng.randrange(len(chunks) + 1), (kind, body))
            case 3:
                chunks[i] = (
                    rng.choice((b"IHDR", b"PLTE", b"IDAT", b"tRNS", b"iCCP", b"eXIf", b"acTL", b"fcTL", b"zTXt", b"gAMA")),
                    body,
                )
            case 4 | 5:
                chunks[0] = (
                    chunks[0][0],
                    _with(
                        chunks[0][1],
                        rng.choice((0, 4)),
                        struct.pack(">I", rng.choice(_SIZES)),
                    ),
                )
            case 6:
                chunks[0] = chunks[0][0], _with(chunks[0][1], rng.randrange(8, 13), bytes([rng.randrange(20)]))
            case 7:
                bomb = zlib.compress(bytes(rng.choice((10, 10**6))))
                chunks.insert(
                    1,
                    rng.choice(((b"zTXt", b"key\0\0" + bomb), (b"iCCP", b"name\0\0" + bomb), (b"iTXt", b"key\0\1\0\0\0" + bomb))),
                )
            case _:
                chunks.insert(1, (b"eXIf", of_tiff(rng, exif_bytes()[6:])))
        if not chunks:
            break
    return data[:8] + b"".join(_png_chunk(kind, body) for kind, body in chunks)


def _png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    chunks, at = [], 8
    while at + 12 <= len(data):
        length = struct.unpack_from(">I", data, at)[0]
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return chunks


def _png_chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def exif_bytes() -> bytes:
    """An EXIF block with an orientation, times and a position."""
    from PIL import Image

    exif = Image.Exif()
    exif[274], exif[306] = 6, "2024:05:01 10:00:00"
    exif.get_ifd(0x8769).update({36867: "2024:05:01 10:00:00", 37521: "25", 41989: 24})
    exif.get_ifd(0x8825).update({1: "N", 2: (49.0, 0.0, 38.5)})
    return exif.tobytes()


def of_jpeg(rng: Random, data: bytes) -> bytes:
    """Segments before the picture: their content, length, order and number; EXIF as a TIFF; the coded picture."""
    segments, rest = jpeg_segments(data)
    if not segments or rng.random() < 0.1:
        return of_bytes(rng, data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        i = rng.randrange(len(segments)) if segments else 0
        match rng.randrange(7) if segments else 6:
            case 0:
                segments[i] = segments[i][0], of_bytes(rng, segments[i][1])
            case 1:
                del segments[i]
            case 2:
                segments.insert(rng.randrange(len(segments) + 1), segments[i])
            case 3:
                segments[i] = rng.choice((0xC0, 0xC2, 0xC4, 0xDB, 0xDD, 0xE0, 0xE1, 0xE2, 0xE3, 0xED, 0xEE, 0xFE)), segments[i][1]
            case 4:
                segments.insert(0, (0xE1, b"Exif\0\0" + of_tiff(rng, exif_bytes()[6:])))
            case 5:  # the frame: precision, height, width, components
                for j, (marker, body) in enumerate(segments):
                    if marker in (0xC0, 0xC2) and len(body) > 6:
                        segments[j] = marker, _with(body, rng.randrange(6), struct.pack(">H", rng.choice((0, 1, 8, 4096, 65535))))
            case _:
                rest = of_bytes(rng, rest)
    return jpeg_of(segments, rest)


def jpeg_segments(data: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """Marker and content of each segment, and what follows from the start of the scan."""
    segments, at = [], 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        length = struct.unpack_from(">H", data, at + 2)[0]
        segments.append((data[at + 1], data[at + 4 : at + 2 + length]))
        at += 2 + max(2, length)
    return segments, data[at:]


def jpeg_of(segments: list[tuple[int, bytes]], rest: bytes) -> bytes:
    """The inverse of `jpeg_segments`; a segment that has grown too long is cut."""
    parts = [b"\xff" + bytes([marker]) + struct.pack(">H", min(len(body), 65533) + 2) + body[:65533] for marker, body in segments]
    return b"\xff\xd8" + b"".join(parts) + rest


def of_flir(rng: Random, data: bytes) -> bytes:
    """Records of FLIR's file inside a JPEG: directory, calibration, embedded images."""
    segments, rest = jpeg_segments(data)
    ours = [i for i, (marker, body) in enumerate(segments) if marker == 0xE1 and body[:5] == b"FLIR\0"]
    if not ours or rng.random() < 0.15:
        return of_jpeg(rng, data)
    fff = b"".join(segments[i][1][8:] for i in ours)
    order = ">" if fff[0x14:0x16] == b"\0\0" else "<"
    start, entries = struct.unpack_from(order + "II", fff, 0x18)
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = start + 32 * rng.randrange(max(1, min(entries, 40)))
        if at + 32 > len(fff):
            break
        _, _, _, _, offset, length = struct.unpack_from(order + "HHIIII", fff, at)
        match rng.randrange(6):
            case 0:
                fff = _with(fff, at + rng.choice((0, 2, 4, 12, 16)), _number(rng, order, rng.choice("HI")))
            case 1:
                fff = of_bytes(rng, fff[:64]) + fff[64:]
            case 2 | 3 if 0 < length <= len(fff) - offset:
                record = fff[offset : offset + length]
                inner = (
                    record.find(b"\x89PNG")
                    if b"\x89PNG" in record[:64]
                    else record.find(b"\xff\xd8")
                    if b"\xff\xd8" in record[:64]
                    else -1
                )
                if inner >= 0 and rng.random() < 0.7:
                    changed = (of_png if record[inner] == 0x89 else of_jpeg)(rng, record[inner:])
                    record = (record[:inner] + changed)[:length].ljust(length, b"\0")
                else:
                    record = _with(record, rng.randrange(min(length, 0x320)), _number(rng, rng.choice("<>"), rng.choice("Hf")))[
                        :length
                    ]
                fff = _with(fff, offset, record)
            case 4 if 0 < length <= len(fff) - offset:  # a field of the calibration, aligned
                fff = _with(
                    fff, offset + 4 * rng.randrange(max(1, min(length, 0x320) // 4)), _number(rng, order, rng.choice("If"))
                )
            case _:
                fff = of_bytes(rng, fff)
    size = 60_000
    parts = [fff[i : i + size] for i in range(0, len(fff), size)][:255]
    new = [(0xE1, b"FLIR\0\x01" + bytes([i, len(parts) - 1]) + part) for i, part in enumerate(parts)]
    others = [segment for i, segment in enumerate(segments) if i not in ours]
    return jpeg_of([*others[:1], *new, *others[1:]], rest)


def of_ply(rng: Random, data: bytes) -> bytes:
    """Words of the header, and numbers of the body."""
    end = data.find(b"end_header\n") + len(b"end_header\n")
    if end < 20 or rng.random() < 0.1:
        return of_bytes(rng, data)
    header, body = data[:end], data[end:]
    for _ in range(rng.choice((1, 1, 2))):
        if rng.random() < 0.6:
            header = of_text(rng, header)
        else:
            body = of_numbers(rng, body)
    return header + body


_ODD_WORDS = (
    *b"0 -1 nan inf -inf 1e400 2000000000 9223372036854775808 18446744073709551616 x float double char ascii vertex # ../../x %s".split(),
    *(b"", b"9" * 400, b"x" * 5000, b"a b", b"1 2 3", b"list uchar float", b"binary_big_endian"),
    *(b"\xff\xfe", b"\0", b"\r", b"\xc3\xa4", b"\xe2\x80\xae"),
)


def of_text(rng: Random, data: bytes) -> bytes:
    """Words and lines."""
    if rng.random() < 0.1:
        return of_bytes(rng, data)
    lines = data.split(b"\n")
    for _ in range(rng.choice((1, 1, 2, 3))):
        i = rng.randrange(len(lines))
        words = lines[i].split(b" ")
        j = rng.randrange(len(words))
        match rng.randrange(7):
            case 0:
                lines.insert(i, lines[i])
            case 1 if len(lines) > 1:
                del lines[i]
            case 2:
                del words[j]
                lines[i] = b" ".join(words)
            case 3:
                words.insert(j, rng.choice(words))
                lines[i] = b" ".join(words)
            case 4:
                k = rng.randrange(len(lines))
                lines[i], lines[k] = lines[k], lines[i]
            case _:
                words[j] = rng.choice(_ODD_WORDS)
                lines[i] = b" ".join(words)
    return b"\n".join(lines)
