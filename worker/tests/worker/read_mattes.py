"""Reads the mattes of an EXR from standard input, checks them, and prints what they show as JSON."""

import json
import struct
import sys
import tempfile

import OpenEXR


def murmur3(data):
    """MurmurHash3_x86_32 with seed 0, written from its definition."""
    mask, value = 0xFFFFFFFF, 0
    rotated = lambda x, by: ((x << by) | (x >> (32 - by))) & mask
    for start in range(0, len(data), 4):
        block = data[start : start + 4]
        k = rotated(int.from_bytes(block, "little") * 0xCC9E2D51 & mask, 15) * 0x1B873593 & mask
        value ^= k
        if len(block) == 4:
            value = (rotated(value, 13) * 5 + 0xE6546B64) & mask
    value ^= len(data)
    value = (value ^ value >> 16) * 0x85EBCA6B & mask
    value = (value ^ value >> 13) * 0xC2B2AE35 & mask
    return value ^ value >> 16


def as_id(name):
    value = murmur3(name.encode())
    if value >> 23 & 255 in (0, 255):
        value ^= 1 << 23
    return value


with tempfile.NamedTemporaryFile(suffix=".exr") as file:
    file.write(sys.stdin.buffer.read())
    file.flush()
    part = OpenEXR.File(file.name, separate_channels=True).parts[0]
    channels = {name: channel.pixels for name, channel in part.channels.items()}
    header = part.header

found = {}
for name, layer in header.items():
    if not (name.startswith("cryptomatte/") and name.endswith("/name")):
        continue
    key = name.split("/")[1]
    assert key == f"{murmur3(layer.encode()):08x}"[:7], key
    assert header[f"cryptomatte/{key}/hash"] == "MurmurHash3_32"
    assert header[f"cryptomatte/{key}/conversion"] == "uint32_to_float32"
    manifest = json.loads(header[f"cryptomatte/{key}/manifest"])
    assert all(hashed == f"{as_id(thing):08x}" for thing, hashed in manifest.items())
    names = {int(hashed, 16): thing for thing, hashed in manifest.items()}
    seen, total = set(), 0
    for rank in range(6):
        pair = "RG" if rank % 2 == 0 else "BA"
        ids, coverage = (channels[f"{layer}{rank // 2:02}.{letter}"] for letter in pair)
        assert str(ids.dtype) == str(coverage.dtype) == "float32"
        total = total + coverage
        for number, part in zip(ids.flat, coverage.flat):
            bits = struct.unpack("<I", struct.pack("<f", float(number)))[0]
            assert (bits == 0) == (part == 0)
            if part > 0:
                seen.add(names[bits])
    assert abs(total - channels["A"].astype("float32")).max() < 1e-3
    found[layer] = {"key": key, "seen": sorted(seen)}
print(json.dumps(found))
