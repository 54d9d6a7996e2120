"""Reads a PNG from standard input with nothing but zlib and struct; writes its raw samples."""
import struct
import sys
import zlib

data = sys.stdin.buffer.read()
assert data[:8] == b"\x89PNG\r\n\x1a\n"
place, compressed, names = 8, b"", []
while place < len(data):
    (length,) = struct.unpack(">I", data[place:place + 4])
    name, body = data[place + 4:place + 8], data[place + 8:place + 8 + length]
    (crc,) = struct.unpack(">I", data[place + 8 + length:place + 12 + length])
    assert zlib.crc32(name + body) == crc, name
    names.append(name)
    if name == b"IHDR":
        width, height, depth, color, compression, filters, interlace = struct.unpack(">IIBBBBB", body)
    elif name == b"sRGB":
        assert body == b"\x00"
    elif name == b"IDAT":
        compressed += body
    place += 12 + length
assert names[0] == b"IHDR" and names[-1] == b"IEND"
assert set(names) == {b"IHDR", b"sRGB", b"iTXt", b"IDAT", b"IEND"}, names
assert compression == filters == interlace == 0

pixel_bytes = {2: 3, 6: 4}[color] * depth // 8
row_bytes = width * pixel_bytes
rows = zlib.decompress(compressed)
assert len(rows) == height * (row_bytes + 1)
above = bytearray(row_bytes)
for y in range(height):
    kind = rows[y * (row_bytes + 1)]
    row = bytearray(rows[y * (row_bytes + 1) + 1:(y + 1) * (row_bytes + 1)])
    for i in range(row_bytes):
        a = row[i - pixel_bytes] if i >= pixel_bytes else 0
        b = above[i]
        c = above[i - pixel_bytes] if i >= pixel_bytes else 0
        p = a + b - c
        nearest = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
        row[i] = (row[i] + (0, a, b, (a + b) // 2, nearest)[kind]) & 255
    sys.stdout.buffer.write(row)
    above = row
