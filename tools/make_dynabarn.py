"""Makes the moving fields that come with armctl: `python tools/make_dynabarn.py FOLDER`.

FOLDER is `jackal_helper` of github.com/Daffan/the-barn-challenge. A world's file names a plugin for each of its discs,
and the plugin's `Load` creates the key frames of an animation: time, x, y. It was compiled without optimization, so its
code loads these numbers one after the other: the duration, and for each frame the time, z, y, x, and three angles.
"""

import functools
import re
import struct
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from armctl.core.files import write_atomically
from armctl.core.shipped import write_shipped
from armctl.tasks.bridge.dynabarn import FIELDS, FILE, FORMAT, LEVELS, MAX_DISCS, ROUTES, DynaBarn

LOADS = re.compile(rb"\x66\x0f\xef\xc0|(?:\x48\x8b\x05|\xf2\x0f\x10\x05)(....)", re.DOTALL)
"""pxor xmm0, xmm0; mov rax, [rip + offset]; movsd xmm0, [rip + offset]."""
FRAME = 7
SYMBOLS, SYMBOL = 2, struct.Struct("<IBBHQQ")
SECTION = struct.Struct("<IIQQQQIIQQ")


def code_of(plugin: bytes) -> tuple[int, int]:
    """Return where the code of `Load` begins and ends in a plugin, an ELF file."""
    (table,), (count,) = struct.unpack_from("<Q", plugin, 0x28), struct.unpack_from("<H", plugin, 0x3C)
    sections = [SECTION.unpack_from(plugin, table + SECTION.size * i) for i in range(count)]
    for _, kind, _, _, begin, size, names, *_ in sections:
        for at in range(begin, begin + size, SYMBOL.size) if kind == SYMBOLS else ():
            name, _, _, _, address, length = SYMBOL.unpack_from(plugin, at)
            first = sections[names][4] + name
            if b"4LoadE" in plugin[first : plugin.index(b"\0", first)]:
                return address, address + length
    raise ValueError("the plugin has no function Load")


def frames_of(plugin: bytes) -> np.ndarray:
    """Return time (s), x and y (m) of a plugin's key frames (k, 3)."""
    begin, end = code_of(plugin)
    numbers = []
    for load in LOADS.finditer(plugin, begin, end):
        (offset,) = struct.unpack("<i", load[1]) if load[1] else (None,)
        numbers.append(0.0 if offset is None else struct.unpack_from("<d", plugin, load.end() + offset)[0])
    frames = np.array(numbers[1:]).reshape(-1, FRAME)
    if frames[:, [1, 4, 5, 6]].any() or frames[-1, 0] != numbers[0] or (np.diff(frames[:, 0]) <= 0).any():
        raise ValueError("these are not the key frames of a disc")
    return frames[:, [0, 3, 2]]


def main(
    folder: Annotated[Path, typer.Argument(help="jackal_helper of the BARN challenge", exists=True)],
    out: Annotated[Path, typer.Option(help="file to write")] = FILE,
) -> None:
    """Read the moving fields of the BARN challenge out of its plugins."""
    names = [f"{level}libobs_{i}.so" for level in LEVELS for i in range(ROUTES)]
    routes = [frames_of((folder / "plugins" / name).read_bytes()) for name in names]
    fields = np.full((len(LEVELS) * FIELDS, MAX_DISCS), -1)
    for i, row in enumerate(fields):
        world = (folder / "worlds" / "DynaBARN" / f"world_{i}.world").read_text(encoding="utf-8")
        of_world = [names.index(name) for name in re.findall(r"filename='([^']+)'", world)]
        row[: len(of_world)] = of_world
    packed = np.concatenate(routes) * (1.0, -1.0, -1.0)  # the challenge's robot drives towards -x
    counts = np.array([len(route) for route in routes], dtype=np.uint8)
    converted = DynaBarn(counts, packed.astype(np.float32), fields.astype(np.int16))
    write_atomically(out, functools.partial(write_shipped, converted, FORMAT))
    typer.echo(f"{len(routes)} routes with {counts.sum()} corners, and {len(fields)} fields: {out}")


if __name__ == "__main__":
    typer.run(main)
