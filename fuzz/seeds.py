#!/usr/bin/env python3
"""Writes the seeds of every fuzz target into fuzz/corpus: the golden messages and pictures of a few hundred bytes.

    python3 fuzz/seeds.py        # needs Pillow; run it when proto/golden/v1 or a format changes

Seeds are called seed-*; what the fuzzer found and what was mended is beside them under its own name and is left alone.
"""

import hashlib
import io
import json
import pathlib
import struct
import zlib

from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
GOLDEN = HERE.parent / "proto" / "golden" / "v1"
HEADER = struct.Struct("<BBBBIIIIfQQII")
WIDTH, HEIGHT = 24, 16


def write(target, name, content):
    folder = HERE / "corpus" / target
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"seed-{name}").write_bytes(content)


def golden_bytes(name):
    return bytes.fromhex((GOLDEN / name).read_text())


def golden_json(name):
    """Without spaces: every byte counts."""
    return json.dumps(json.loads((GOLDEN / name).read_text()), separators=(",", ":")).encode()


def picture(mode):
    image = Image.new("RGB", (WIDTH, HEIGHT))
    image.putdata([((9 * u + 3 * v) % 256, (7 * u * v) % 256, (200 - 5 * u) % 256) for v in range(HEIGHT) for u in range(WIDTH)])
    return image.convert(mode)


def saved(image, kind, **options):
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def header(pixel_format, depth_format=0, row_bytes=0, depth_offset=0, width=WIDTH, height=HEIGHT):
    return HEADER.pack(1, pixel_format, depth_format, 0, width, height, row_bytes, depth_offset, 0.001, 7, 1700000000, 1000, 0)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(bit_depth, color_type, interlaced, extra=b""):
    """A PNG written by hand, for the kinds that Pillow does not write: rows use each filter in turn."""
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[color_type]
    passes = [(0, 0, 1, 1)]
    if interlaced:
        passes = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]
    rows = bytearray()
    for x, y, step_x, step_y in passes:
        for row in range(len(range(y, HEIGHT, step_y))):
            bits = len(range(x, WIDTH, step_x)) * channels * bit_depth
            rows.append(row % 5)
            rows += bytes((13 * row + 5 * at) % 256 for at in range((bits + 7) // 8))
    ihdr = struct.pack(">IIBBBBB", WIDTH, HEIGHT, bit_depth, color_type, 0, 0, int(interlaced))
    palette = chunk(b"PLTE", bytes(range(48))) if color_type == 3 else b""
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", ihdr) + extra + palette + chunk(b"IDAT", zlib.compress(bytes(rows))) + chunk(b"IEND", b"")


def headers():
    for name in ("frame_header", "frame_header_secret"):
        write("header", name, golden_bytes(f"{name}.hex"))
    write("header", "bare_secret", bytes(range(16)))
    for pixel_format in range(10):
        write("header", f"format_{pixel_format}", header(pixel_format))


def raw_frames():
    bytes_per_pixel = {1: 1, 2: 2, 3: 3, 4: 3, 5: 4, 6: 4, 7: 4, 8: 2, 9: 1}
    for pixel_format, size in bytes_per_pixel.items():
        rows = HEIGHT * 3 // 2 if pixel_format == 9 else HEIGHT
        pixels = bytes((at * 37) % 251 for at in range(WIDTH * rows * size))
        if pixel_format == 7:
            pixels = struct.pack(f"<{WIDTH * HEIGHT}f", *(at / 400 for at in range(WIDTH * HEIGHT)))
        write("raw", f"format_{pixel_format}", header(pixel_format) + pixels)
    pixels = bytes(200 for _ in range((WIDTH + 4) * HEIGHT))
    for depth_format, size in ((1, 2), (2, 4)):
        head = header(1, depth_format, WIDTH + 4, len(pixels) + 4)
        write("raw", f"depth_{depth_format}", head + pixels + bytes(4) + bytes(63 for _ in range(WIDTH * HEIGHT * size)))


def pictures():
    for mode in ("1", "L", "LA", "RGB", "RGBA", "P"):
        write("png", mode.lower(), saved(picture(mode), "PNG"))
    for bit_depth, color_type in ((1, 0), (2, 0), (4, 0), (8, 0), (16, 0), (4, 3), (8, 2), (16, 2), (16, 4), (8, 6), (16, 6)):
        write("png", f"interlaced_{color_type}_{bit_depth}", png(bit_depth, color_type, True))
    write("png", "chunks", png(8, 0, False, chunk(b"gAMA", struct.pack(">I", 45455)) + chunk(b"tEXt", b"a\0b") + chunk(b"iCCP", b"p\0\0" + zlib.compress(bytes(99)))))
    write("png", "transparent", png(8, 2, False, chunk(b"tRNS", bytes(6))))
    write("png", "animated", png(8, 0, False, chunk(b"acTL", struct.pack(">II", 1, 0)) + chunk(b"fcTL", struct.pack(">IIIIIHHBB", 0, WIDTH, HEIGHT, 0, 0, 1, 10, 0, 0))))
    for mode in ("L", "RGB", "CMYK"):
        for progressive in (False, True):
            write("jpeg", f"{mode.lower()}{'_progressive' if progressive else ''}", saved(picture(mode), "JPEG", progressive=progressive, quality=60))
    for subsampling in (0, 1, 2):
        write("jpeg", f"subsampled_{subsampling}", saved(picture("RGB"), "JPEG", subsampling=subsampling))
        write("jpeg", f"subsampled_{subsampling}_progressive", saved(picture("RGB"), "JPEG", subsampling=subsampling, progressive=True))
    write("jpeg", "restarts", saved(picture("RGB"), "JPEG", restart_marker_blocks=1))
    write("jpeg", "restarts_progressive", saved(picture("RGB"), "JPEG", restart_marker_rows=1, progressive=True))
    write("jpeg", "commented", saved(picture("L"), "JPEG", comment=b"hello", exif=b"Exif\0\0II*\0\x08\0\0\0\0\0\0\0"))


def bodies():
    write("settings", "create", golden_json("create.json"))
    write("settings", "complete", golden_json("settings.json"))
    for name, patch in {
        "hahn": {"method": "hahn", "window": {"fixed": {"a": [1, 2], "b": 8}}, "order": {"min": 2, "max": 9}},
        "krawtchouk": {"method": "krawtchouk", "krawtchouk": {"p": [0.4, 0.6], "lattice": "exact"}, "order": 5},
        "pixels": {"method": "gaussian_mixture", "gaussian_px": 7, "light": {"gain_std": 0.1}, "noise_floor": "subtract"},
        "gains": {"gain": {"adaptive": {"at_zero": 4, "at_infinity": 1, "slope_at_zero": 30}}, "limits": None, "step_cap": "none"},
        "depth": {"depth": {"map": {"fallback_m": 1.5, "holes": "ignore"}}, "degrees_of_freedom": [True] * 5 + [False]},
        "mask": {"preprocess": {"invert": True, "mask": {"png_base64": "iVBORw0KGgoAAAANSUhEUgAAAAgAAAAICAAAAADhZOFX"}}},
        "frames": {"frames": {"key": "domvs/camera/front/frame"}, "watchdog_ms": 500, "lease": "none", "stop": {"hold_frames": 2}},
        "refused": {"ros2": {"topic": "a"}, "preprocess": {"resize": 2}, "unknown": [[[1e308]]]},
    }.items():
        change = json.dumps(patch, separators=(",", ":")).encode()
        write("settings", name, golden_json("create.json") + b"\0" + change)
    for name in ("control", "control_reply", "create_reply", "error_reply", "status", "worker_info", "camera_info", "task_state"):
        write("messages", name, golden_json(f"{name}.json"))
    for name in ("twist", "twist_zero"):
        write("twist", name, golden_bytes(f"{name}.hex"))
        write("twist", f"{name}_json", golden_json(f"{name}.json"))
    (HERE / "corpus" / "config").mkdir(exist_ok=True)
    write("config", "shipped", (HERE.parent / "deploy" / "server.toml").read_bytes())


def state_file(state, head=b"", encoding=b"", payload=b""):
    parts = [json.dumps(state, separators=(",", ":")).encode(), head, encoding, payload]
    content = b"domvs-state 1\n" + struct.pack("<4Q", *map(len, parts)) + b"".join(parts)
    return content + hashlib.sha3_256(content).digest()


def states():
    state = json.loads((GOLDEN / "task_state.json").read_text())
    write("state", "bare", state_file(state | {"target": None}))
    # Without a deadline, as a target is kept.
    head, encoding, payload = header(1)[:-8] + bytes(8), b"image/x", bytes(WIDTH * HEIGHT)
    hashed = hashlib.sha3_256(head + struct.pack("<Q", len(encoding)) + encoding + payload).hexdigest()
    target = {"hash": hashed, "width": WIDTH, "height": HEIGHT, "payload_bytes": len(payload)}
    write("state", "target", state_file(state | {"target": target}, head, encoding, payload))
    write("state", "another_target", state_file(state, head, encoding, payload))
    write("state", "unnamed_target", state_file(state | {"target": None}, head, encoding, payload))


def keys():
    leaves = ("target", "twist", "frame", "command", "status", "settings", "control", "state", "owner/w1/65578")
    texts = [f"domvs/task/alice/t1/{leaf}" for leaf in leaves]
    texts += ["domvs/worker/w1/create/alice", "domvs/worker/w1/alive", "domvs/client/alice/alive", "domvs/camera/front/alive"]
    texts += ["alice/t1", "alice", "lab-1/arm_2", "domvs/task/a*/t1/twist", "domvs//task", "a" * 65, "\N{GREEK SMALL LETTER OMEGA}"]
    for number, text in enumerate(texts):
        write("keys", f"{number:02}", text.encode())


def tasks():
    picture_of = lambda way, shift, kind=0: bytes([way, kind, shift, 200, 5])
    start = bytes([0, 0])
    patch = lambda change: bytes([2, len(change)]) + change
    write("task", "servo", picture_of(1, 180) + start + b"".join(picture_of(5, 170 + 2 * n) + bytes([3, 8]) for n in range(8)))
    write("task", "requests", picture_of(1, 180) + start + b"".join(picture_of(6, 185 - n) for n in range(8)))
    write("task", "depth", patch(b'{"depth":"map"}') + picture_of(1, 180, 32) + start + picture_of(6, 175, 32) + picture_of(5, 176, 40))
    write("task", "floats", picture_of(1, 180, 16) + start + picture_of(6, 175, 0x50) + picture_of(6, 175, 0x90) + picture_of(6, 175, 0xd0))
    write("task", "changes", picture_of(1, 180) + start + picture_of(6, 175) + patch(b'{"method":"photometric"}') + picture_of(6, 175) + patch(b'{"gain":{"per_s":9}}') + picture_of(5, 174))
    write("task", "halts", picture_of(1, 180) + start + picture_of(6, 175) + bytes([4, 1]) + picture_of(6, 175) + bytes([0, 2]) + picture_of(6, 175) + bytes([4, 2, 0, 0]))
    write("task", "header", picture_of(1, 180) + start + bytes([6, 7, 0, 36, 0]) + header(1) + bytes(24 * 24))


if __name__ == "__main__":
    headers()
    raw_frames()
    pictures()
    bodies()
    states()
    keys()
    tasks()
