"""Fault 24: a damaged or hostile motion file ends in a valid clip or one FileError, soon and small.

Mutants of a valid file of every format are read in a process of their own, which has 500 MB of
address space beyond what it held after reading the valid files, and 2 s of a core for each mutant.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import resource
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import forked
from motion_files import ASF, WRITE

import understudy_motion
from understudy.errors import FileError
from understudy.setup.registry import Registrar, Registry
from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics
from understudy_motion.reading import HEAD_BYTES, ReadOptions, readers

SECONDS = 2.0
HEADROOM = 500 * 2**20
FORMATS = (*WRITE, "asf")

#: What replaces a word of a text file.
WORDS = (
    "nan", "-nan", "inf", "-inf", "1e308", "-1e308", "1e-308", "1e999", "0", "-1", "7", "1_0", "0x10",
    "999999999", "99999999999999999999", "9" * 5000, "true", "null", "[]", "{}", "{", "}", '"', "''",
    "\0", "é", "٣", "#", ":", ",", ",,", "x" * 10_000, "root", "End Site", "MOTION", ":DEGREES", "",
)  # fmt: skip


def mutant_of_bytes(content: bytes, rng: random.Random) -> bytes:
    """Truncated, flipped, cut, doubled, swapped, filled with anything."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 5))):
        start = rng.randrange(len(data) + 1)
        stop = min(len(data), start + rng.choice((1, 4, 40, 400)))
        match rng.randrange(6):
            case 0:
                del data[start:]
            case 1:
                for at in range(start, stop):
                    data[at] ^= 1 << rng.randrange(8)
            case 2:
                del data[start:stop]
            case 3:
                data[start:start] = data[start:stop] * rng.choice((1, 2, 50))
            case 4:
                data[start:stop] = rng.randbytes(stop - start)
            case 5:
                data[start:start] = rng.choice((b"\0", b"\xff", b"\r", b"\n", b" ")) * 9
    return bytes(data)


def mutant_of_text(content: bytes, rng: random.Random) -> bytes:
    """Lines and words reordered, doubled, deleted and replaced; sometimes nested without end."""
    text = content.decode()
    for _ in range(rng.choice((1, 1, 2, 4))):
        pattern = r"[^\n]*\n" if rng.random() < 0.4 else r"[\s,:\[\]{}]+|[^\s,:\[\]{}]+"
        pieces = re.findall(pattern, text) or [text]
        at, other = rng.randrange(len(pieces)), rng.randrange(len(pieces))
        match rng.randrange(6):
            case 0:
                pieces[at], pieces[other] = pieces[other], pieces[at]
            case 1:
                pieces[at:at] = pieces[at : other + 1]
            case 2:
                del pieces[at : at + rng.choice((1, 1, 3))]
            case 3 | 4:
                pieces[at] = rng.choice(WORDS)
            case 5 if rng.random() < 0.05:
                pieces[at:at] = [
                    rng.choice(("[", "{", '{"a":', "JOINT a {\nOFFSET 0 0 0\n"))
                ] * 50_000
            case _:
                pieces[at:at] = [rng.choice(WORDS), " "]
        text = "".join(pieces)
    return text.encode(errors="replace")


class Payload:
    """Creates a file when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("executed"),)


def mutant_of_arrays(content: bytes, rng: random.Random) -> bytes:
    """One array of an NPZ of another type, shape or content, lying about its size, or missing."""
    members = unpacked(content)
    name = rng.choice(list(members))
    array = np.load(io.BytesIO(members[name]), allow_pickle=False)
    match rng.randrange(10):
        case 0:
            del members[name]
        case 1:
            odd = np.empty(array.shape, dtype=object)
            odd[...] = Payload()
            members[name] = saved(odd)
        case 2:
            dtype = rng.choice(
                ("f2", "f4", "f8", "i1", "i8", "u4", "b1", "c16", "U5", "S5", "M8[s]")
            )
            members[name] = saved(np.zeros(array.shape, dtype))
        case 3:
            shapes = ((), (0,), (1,), (0, 0), (2,) * 20, (*array.shape, 1), array.shape[:-1])
            members[name] = saved(np.zeros(rng.choice(shapes), array.dtype))
        case 4:
            members[name] = saved(np.concatenate([np.atleast_1d(array)] * rng.choice((2, 3))))
        case 5 if array.dtype.kind == "f":
            flat = array.astype(np.float64).reshape(-1)
            for _ in range(rng.choice((1, 3))):
                flat[rng.randrange(flat.size)] = rng.choice(
                    (np.nan, np.inf, 1e308, -1e308, 0.0, 1e-308)
                )
            members[name] = saved(flat.reshape(array.shape))
        case 5 if array.dtype.kind == "i":
            members[name] = saved(array + rng.choice((-(2**62), -3, 1, 5, 2**62)))
        case 6:
            shape = rng.choice(
                ("(10**9,)", "(1000000000, 3)", "(-1,)", "(2**70,)", "()", "'a'", "(1.5,)")
            )
            members[name] = members[name][:10] + members[name][10:].replace(
                str(array.shape).encode(), shape.encode(), 1
            )
        case 7 if rng.random() < 0.1:
            megabytes = rng.choice((10, 150))
            members[name] = saved(np.zeros((megabytes * 2**20 // 528, 66)))
        case 8:
            members[name] = mutant_of_bytes(members[name], rng)
        case _:
            members[rng.choice(("x", "../x.npy", "poses.npy", "format.npy"))] = members[name]
    return packed(members, rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))


def unpacked(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        return {name: file.read(name) for name in file.namelist()}


def packed(members: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """An archive without the time of day, of which its mutants would be others each time."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        for name, data in members.items():
            file.writestr(zipfile.ZipInfo(name), data, compression)
    return out.getvalue()


def saved(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def mutate(format: str, content: bytes, rng: random.Random) -> bytes:
    kinds: tuple[Callable[[bytes, random.Random], bytes], ...]
    if format in ("npz", "robot_npz", "smpl"):
        kinds = (mutant_of_bytes, mutant_of_arrays, mutant_of_arrays, mutant_of_arrays)
    else:
        kinds = (mutant_of_bytes, mutant_of_text, mutant_of_text, mutant_of_text)
    return rng.choice(kinds)(content, rng)


def check(clip: Clip) -> None:
    """A valid clip is finite, also its figure's every joint."""
    assert clip.num_frames >= 2
    assert clip.root_position.isfinite().all()
    assert clip.rotations.isfinite().all()
    assert clip.duration > 0.0
    if clip.skeleton is not None:
        positions, _ = forward_kinematics(clip)
        assert positions.isfinite().all()


def read_mutants(format: str, count: int, seed: int) -> dict[str, Any]:
    """How `count` mutants end: numbers of clips and refusals, what went wrong, the slowest in s."""
    registry = Registry()
    Registrar(registry, "motion").tables(understudy_motion)
    known = readers(registry)
    rng = random.Random(f"{format} {seed}")
    ends: dict[str, Any] = {"clips": 0, "refused": 0, "wrong": [], "slowest": 0.0}
    path = WRITE["amc" if format == "asf" else format](Path.cwd())
    damaged = path.with_name("small.asf") if format == "asf" else path
    original = ASF.encode() if format == "asf" else path.read_bytes()
    if path.suffix == ".npz":
        original = packed(unpacked(original))
    reader = known["amc" if format == "asf" else format]
    for reader_name in known:  # everything that is loaded on first use is loaded
        check(known[reader_name].read(WRITE[reader_name](Path.cwd())))
    limit = address_space() + HEADROOM
    for index in range(count):
        content = mutate(format, original, rng)
        damaged.unlink()  # to write over it takes a file system longer than most readers take
        damaged.write_bytes(content)
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
        options = rng.choice((ReadOptions(), ReadOptions(unit="cm", up="y", rate=30.0)))
        began = time.process_time()  # what others do on a busy machine is none of it
        try:
            with path.open("rb") as file:
                head = file.read(HEAD_BYTES)
            for other in known.values():
                other.recognises(head, path)
            check(reader.read(path, options))
            ends["clips"] += 1
        except FileError as error:
            ends["refused"] += 1
            if "\n" in str(error) or len(str(error)) > 1000:
                ends["wrong"].append(f"{index}: message {str(error)[:200]!r}")
        except BaseException as error:
            damaged.with_name(f"{format}-{seed}-{index}.mutant").write_bytes(content)
            ends["wrong"].append(f"{index}: {type(error).__name__}: {error}"[:300])
        seconds = time.process_time() - began
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        ends["slowest"] = max(ends["slowest"], seconds)
        if seconds > SECONDS:
            ends["wrong"].append(f"{index}: {seconds:.1f} s")
        if Path("executed").exists():
            ends["wrong"].append(f"{index}: a payload was executed")
            break
    return ends


def address_space() -> int:
    """Bytes of address space of this process."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


#: Warnings are errors; the folders of the formats are removed.
MUTANTS = """
import json, os, sys, tempfile, warnings
sys.path.insert(0, {folder!r})
import test_24_mutated_clips as faults
warnings.simplefilter("error")
count, seed, *formats = sys.argv[1:]
home, result = os.getcwd(), dict()
for format in formats:
    with tempfile.TemporaryDirectory(dir=".") as place:
        os.chdir(place)
        result[format] = faults.read_mutants(format, int(count), int(seed))
        os.chdir(home)
print(json.dumps(result))
"""


def in_a_process(folder: Path, formats: tuple[str, ...], count: int, seed: int) -> dict[str, Any]:
    """What :func:`read_mutants` returns for each format, from one process of its own."""
    code = MUTANTS.format(folder=os.fspath(Path(__file__).parent))
    done = forked(code, str(count), str(seed), *formats, cwd=folder, seconds=3000)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


needs_proc = pytest.mark.skipif(
    not Path("/proc/self/statm").is_file(),
    reason="the memory of a process is not told by this system",
)


@needs_proc
def test_mutants_end_in_a_clip_or_one_sentence(tmp_path: Path) -> None:
    ends = in_a_process(tmp_path, FORMATS, 300, seed=1)
    assert set(ends) == set(FORMATS)
    for format, end in ends.items():
        assert end["wrong"] == [], format
        assert end["clips"] + end["refused"] == 300
        assert end["refused"] > 30, f"the mutants of {format} are too tame"
        assert end["clips"] > 3, f"the mutants of {format} are too wild"


@needs_proc
@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("format", FORMATS)
def test_ten_thousand_mutants(tmp_path: Path, format: str) -> None:
    end = in_a_process(tmp_path, (format,), 10_000, seed=2)[format]
    print(format, end)
    assert end["wrong"] == []


@needs_proc
def test_the_limits_are_real(tmp_path: Path) -> None:
    """A reader without bounds is found out: for memory, for time, and for what it lets through."""
    script = (
        "import json, sys, time\n"
        f"sys.path.insert(0, {os.fspath(Path(__file__).parent)!r})\n"
        "import numpy as np\n"
        "import test_24_mutated_clips as faults\n"
        "from understudy_motion.readers.table import CsvReader\n"
        "faults.SECONDS = 0.2\n"
        "whole, calls = CsvReader.read, []\n"
        "def careless(self, path, options=None):\n"
        "    calls.append(path)\n"
        "    if len(calls) == 2:\n"
        "        np.ones(600 * 2**20, np.int8)\n"
        "    if len(calls) == 3:\n"
        "        until = time.process_time() + 0.3\n"
        "        while time.process_time() < until: pass\n"
        "    if len(calls) == 4:\n"
        "        raise ValueError('unforeseen')\n"
        "    return whole(self, path)\n"
        "CsvReader.read = careless\n"
        "print(json.dumps(faults.read_mutants('csv', 4, 1)['wrong']))\n"
    )
    done = forked(script, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    memory, seconds, error = json.loads(done.stdout)
    assert "MemoryError" in memory
    assert "0.3 s" in seconds
    assert "ValueError: unforeseen" in error
