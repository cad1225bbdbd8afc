"""Hostile scene files, saved plans and FMUs, of which every one has to be refused (`strangers`)."""

from __future__ import annotations

import io
import itertools
import json
import os
import random
import re
import struct
import tempfile
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import contact_system as cs
from contact_system.saved import digest
from contact_system.scene.files import scene_text

Make = Callable[[Path], Path | None]
"""Writes a file at a path, or returns another path."""
Files = dict[str, Make]


# --- scene files ---------------------------------------------------------------------------------


@cache
def scene_files() -> Files:
    """Scene files."""
    good, rng = scene_text("K1")[0], random.Random(1)
    texts: dict[str, str | bytes] = {}
    for n in (300, 3000, 400_000):
        deep = {"lists": "[" * n, "tables": "{a=" * n, "closed": "[" * n + "]" * n}
        deep |= {"key": "a" + ".a" * n + " = 1", "header": f"[{'a.' * n}a]", "quoted": '"a".' * n}
        texts |= {f"{name} {n} deep": f"x = {text}" for name, text in deep.items()}
        forms = ["(" * n + "1", "-" * n + "1", "1-" * n + "1", "sin(" * n + "1" + ")" * n, "a" * n]
        texts |= {f"formula {x[:4]} {n}": _set(good, "duration", f'"{x}"') for x in forms}
    for key in ("name", "duration", "profile", "gain", "object", "contacts", "x" * 900_000):
        for value in ("1979-05-27", f"[{'1,' * 400_000}]", f'["{"x" * 900_000}"]'):
            texts[f"{key[:9]} = {value[:4]}"] = _set(good, key, value)
    for value in ("9" * 5000, "0x" + "f" * 5000, "1e999", "-inf", "nan", "1e-400"):
        texts[f"duration {value[:6]}"] = _set(good, "duration", value)
    window = 'kind = "finger acceleration"\ncontact = "all"\nstart = 0\nstop = 1\nvalue = [0, 1]\n'
    texts["windows"] = good + f"[[disturbances]]\n{window}" * 9000
    texts["coefficients"] = _set(good, "profile", f"[{'0.1,' * 9000}]")
    texts["escapes"] = good + '\n["\\u001b[2J\\u202e"]\nx = 1\n'
    texts |= {f"noise {k}": rng.randbytes(10 ** rng.randint(1, 6)) for k in range(15)}
    texts |= {code: ("ä" + good).encode(code, "replace") for code in ("utf-16", "utf-32", "cp037")}
    return {name: writer(content) for name, content in texts.items()} | _special_files()


def _set(text: str, key: str, value: str) -> str:
    """The text with a key of the first level set to a value."""
    kept = [line for line in text.splitlines() if not line.startswith(f"{key} =")]
    return "\n".join([f"{key} = {value}", *kept])


def writer(content: str | bytes) -> Make:
    """What writes this content."""
    data = content.encode() if isinstance(content, str) else content
    return lambda path: path.write_bytes(data) and None


def _special_files() -> Files:
    """What is no regular file, or larger than any disk."""

    def sparse(path: Path) -> None:
        with open(path, "wb") as file:
            file.truncate(1 << 40)

    found: Files = {"sparse": sparse, "missing": lambda path: None, "folder": os.mkdir}
    found |= {"pipe": os.mkfifo, "link to itself": lambda path: path.symlink_to(path)}
    for name in ("zero", "null", "urandom", "full"):
        device = Path("/dev", name)
        found[name] = lambda path, device=device: device
        found[f"link to {name}"] = lambda path, device=device: path.symlink_to(device)
    return found


# --- saved plans ---------------------------------------------------------------------------------


@cache
def saved(kind: str) -> dict[str, bytes]:
    """Members of a saved plan: begun as its scene says, restarted or continued."""
    plan = cs.plan(cs.load_scene("K2"))
    if kind == "restarted":
        plan = plan.restart(0.5, plan.states(0.5)[0])
    elif kind == "continued":
        plan = plan.continued(0.5)
    with tempfile.TemporaryDirectory() as folder:
        plan.save(Path(folder, "plan.npz"), [plan.start])
        with zipfile.ZipFile(Path(folder, "plan.npz")) as archive:
            return {m: archive.read(m) for m in archive.namelist()}


def text_of(kind: str, name: str) -> str:
    """The scene or the header of a saved plan."""
    return str(np.load(io.BytesIO(saved(kind)[f"{name}.npy"])))


def pack(path: Path, members: dict[str, bytes]) -> None:
    """Write an archive."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def with_texts(path: Path, kind: str, signed: bool = True, **texts: str) -> None:
    """A saved plan with another scene or header, and the digest that fits, or none."""
    members = saved(kind) | {f"{name}.npy": _npy(text) for name, text in texts.items()}
    if signed:
        names = ("scene", "plan")
        members["digest.npy"] = _npy(digest([texts.get(n) or text_of(kind, n) for n in names]))
    else:
        del members["digest.npy"]
    pack(path, members)


def _npy(value: Any) -> bytes:
    out = io.BytesIO()
    np.save(out, np.array(value), allow_pickle=True)
    return out.getvalue()


def _array(shape: str, kind: str) -> bytes:
    """An array whose head promises more than follows."""
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}}}".ljust(117)
    return b"\x93NUMPY\1\0" + struct.pack("<H", 118) + head.encode() + b"\n"


WRONG = (None, True, -1, 0, 1e308, float("nan"), "x" * 10**6, [], {}, [[]])
"""In the place of a header's values."""


@cache
def plan_files() -> Files:
    """Saved plans."""
    found = _special_files()
    head = json.loads(text_of("begun", "plan"))
    headers = ["[" * 10**6, "9" * 10**6, "null", '{"a":' * 10**5, json.dumps(head | {"a": 1})]
    for key, value in itertools.product(head, WRONG):
        if (key, value) not in (("start", 0), ("starts", None)):
            headers.append(json.dumps(head | {key: value}))
    for k, text in enumerate(headers):
        found[f"header {k}: {text[:90]}"] = lambda p, t=text: with_texts(p, "begun", plan=t)
    for text in ("[" * 10**6, "a" + ".a" * 10**5, "\ud800", "x" * 2 * 10**6):
        found[f"scene {text[:9]!r}"] = lambda p, t=text: with_texts(p, "begun", False, scene=t)
    members, contents = saved("begun"), {"zeros": b"\0" * 10**6, "pickle": _npy({"a": 1})}
    arrays = (
        ("()", "<U1000000000"),
        ("(10**12,)", "<U1"),
        ("(1000000000000,)", "<f8"),
        ("(", "<U4"),
    )
    contents |= {" ".join(array): _array(*array) for array in arrays}
    for name, content in contents.items():
        changed = members | {"scene.npy": content}
        found[name] = lambda p, m=changed: pack(p, m)
    found |= {"bomb": _bomb, "encrypted": _marked(6, 1), "unknown packing": _marked(8, 99)}
    found["no scene"] = lambda p: pack(p, {"plan.npy": members["plan.npy"]})
    found["table of contents"] = lambda p: pack(p, dict.fromkeys(map(str, range(60_000)), b""))
    return found | {f"noise {k}": writer(random.Random(k).randbytes(10**5)) for k in range(5)}


def _bomb(path: Path) -> None:
    """A scene of 100 MB, which packs to 0.1 MB."""
    pack(path, {k: v for k, v in saved("begun").items() if k != "scene.npy"})
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("scene.npy", "w") as out:
            for _ in range(10):
                out.write(b"\0" * 10**7)


def _marked(offset: int, value: int) -> Make:
    """A saved plan with a field of its entries, there and in the table of contents, set."""

    def make(path: Path) -> None:
        pack(path, saved("begun"))
        data = bytearray(path.read_bytes())
        for mark, shift in ((b"PK\3\4", 0), (b"PK\1\2", 2)):
            for match in re.finditer(mark, bytes(data)):
                struct.pack_into("<H", data, match.start() + shift + offset, value)
        path.write_bytes(data)

    return make


# --- FMUs ----------------------------------------------------------------------------------------

OUTSIDE = "../" * 12 + "lib/x86_64-linux-gnu/libm"
ENTITIES = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(9))
BOMB = f'<!DOCTYPE x [<!ENTITY a0 "a">{ENTITIES}]><fmiModelDescription x="&a9;" '
ARRAY = (
    '<Float64 name="x" valueReference="99999" causality="output"><Dimension start="{}"/></Float64>'
)
IDENTIFIERS = (OUTSIDE, OUTSIDE[35:], "..\\x", "C:x", "", "..", "a" * 10**6)
DESCRIPTIONS = {
    "entities": ("<fmiModelDescription ", BOMB),
    "cut": ("<ModelVariables>(.|\n)*", ""),
    "deep": ("<ModelVariables>", "<a>" * 10**5),
    "no version": (r'fmiVersion="[^"]*"', ""),
    "version 9": (r'fmiVersion="[^"]*"', 'fmiVersion="9.0"'),
    "no name": (r'<Float64 name="[^"]*"', "<Float64 "),
    "no reference": (r'valueReference="\d+"', ""),
    "long reference": (r'valueReference="\d+"', f'valueReference="{"9" * 5000}"'),
    "huge array": ("</ModelVariables>", ARRAY.format(10**12) + "</ModelVariables>"),
    "negative array": ("</ModelVariables>", ARRAY.format(-3) + "</ModelVariables>"),
    "endless array": ("</ModelVariables>", ARRAY.format("9" * 4000) + "</ModelVariables>"),
    "type": ("<Float64 ", "<Float65 "),
}
"""What is put in the place of what."""
NAMES = ("../x", "/x", "a\\b", "C:x", "a//b", "./a", "a/" * 5000 + "x", "x" * 5000)
NAMES += ("binaries", "modelDescription.xml/x")


@cache
def fmu_files() -> Files:
    """FMUs."""
    from fmu_export import export_fmu

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "k1.fmu")
        export_fmu(cs.load_scene("K1"), path, fmi_version="3.0", interfaces=["CoSimulation"])
        with zipfile.ZipFile(path) as archive:
            good = {m: archive.read(m) for m in archive.namelist() if not m.endswith("/")}
    place = next(name for name in good if name.startswith("binaries/"))
    library, text = good[place], good["modelDescription.xml"].decode()
    found: Files = {
        "empty": writer(b""),
        "noise": writer(b"PK\3\4" + random.Random(1).randbytes(999)),
    }

    def add(name: str, **changes: bytes) -> None:
        found[name] = lambda path: pack(path, good | changes)

    edits = DESCRIPTIONS | {
        f"identifier {x[:9]}": ('modelIdentifier="[^"]*"', f'modelIdentifier="{x}"')
        for x in IDENTIFIERS
    }
    for name, (old, new) in edits.items():
        changed = re.sub(old, lambda _, new=new: new, text, count=1).encode()
        add(name, **{"modelDescription.xml": changed})
    contents = {
        f"cut to {share:.0%}": library[: int(share * len(library))] for share in (0.1, 0.5, 0.99)
    }
    contents |= {f"{x[:4]!r}": x for x in (b"", b"MZ", b"\x7fELF", b"x" * 999)}
    contents |= {"zeros": library[:64] + bytes(len(library))}
    contents |= {"of another machine": library[:18] + b"\x28" + library[19:]}
    contents |= {"of C": next(Path("/lib").glob("*/libm.so.6")).read_bytes()}
    for name, content in contents.items():
        add(f"library {name}", **{place: content})
    for name in NAMES:
        add(f"name {name[:9]}", **{name: b"x"})
    return found
