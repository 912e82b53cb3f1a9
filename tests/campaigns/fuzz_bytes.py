"""Coverage-guided bad input: Atheris looks for bytes that take the readers of files somewhere new.

    python tests/campaigns/fuzz_bytes.py --seed 0 --count 50000

fuzz.py changes whole files and runs whole programs; this one runs the readers alone, some hundred times a second, on
bytes that are kept where they reach lines that none did before. Well: what is read, or an InputError that says what to
do; within 10 s and 2 GiB. Started again with the same --out, readers that are done are left out. What is not answered
well is kept in OUT/SEED/READER/. Exit code 1: something is not; 2: bad input.
"""

import dataclasses
import hashlib
import importlib.util
import json
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("OMP_NUM_THREADS", "1")

import tyro  # noqa: E402

from models.checks import LARGEST_SEED, require_numbers  # noqa: E402
from models.command_line import run  # noqa: E402
from models.errors import InputError  # noqa: E402
from tests.campaigns.fuzz_case import REMEDY  # noqa: E402

SECONDS, MEBIBYTES, LARGEST = 10, 2048, 16_384  # of one input: time, memory, bytes
SHOWN = 3  # of what is not answered well, in words

Reader = tuple[str, Callable[[Path], object], list[bytes]]  # suffix of its files, what reads one, files to begin with


@dataclass
class FuzzBytesArguments:
    """Command line of fuzz_bytes.py."""

    seed: int = 0
    count: int = 50_000  # inputs of each reader
    readers: list[str] = dataclasses.field(default_factory=list)  # these alone
    out: Path = Path("outputs/campaigns/fuzz_bytes")


def _scenario(folder: Path) -> Reader:
    from diagrams.world.scenario import Scenario, load_scenario, save_scenario

    save_scenario(folder / "scenario.yaml", Scenario())
    return ".yaml", load_scenario, [(folder / "scenario.yaml").read_bytes(), b"seed: 3\nworld: {opening: 0.07}\n"]


def _detector(folder: Path) -> Reader:
    import numpy as np

    from models.files.detectors import StoredDetector, load_detector, save_detector

    save_detector(folder / "knn.safetensors", StoredDetector("knn", {"angles": np.zeros((2, 3), np.float32)}, {}))
    return ".safetensors", lambda path: load_detector(path, "knn"), [(folder / "knn.safetensors").read_bytes()]


def _network(folder: Path) -> Reader:
    from diagrams.world.names import WEIGHTS
    from models.files.onnx_messages import parse_model
    from models.files.policies import read_policy, write_policy

    facts, small = read_policy(WEIGHTS / "lstm.onnx")[0], parse_model(b"")
    small.graph.node.add().op_type = "Add"
    path = folder / "lstm.onnx"
    write_policy(path, dataclasses.replace(facts, metadata={}, torch=None), small.SerializeToString())
    return ".onnx", read_policy, [path.read_bytes()]


def _record(folder: Path) -> Reader:
    from diagrams.episodes.record import load_record, save_record
    from tests.diagrams.episode_fakes import OUTCOME
    from tests.diagrams.recorded_run import recorded_run

    save_record(folder / "record.npz", recorded_run(2), OUTCOME)
    return ".npz", load_record, [(folder / "record.npz").read_bytes()]


def _rows(folder: Path) -> Reader:
    from diagrams.episodes.store import RowStore

    def read(path: Path) -> object:
        with RowStore(path, {"code": 1}) as store:
            return dict(store.rows)

    whole = [{"fingerprint": {"code": 1}}, {"key": "a", "row": {"n": 1}}]
    return ".jsonl", read, ["".join(json.dumps(line) + "\n" for line in whole).encode()]


def _motions(folder: Path) -> Reader:
    import h5py
    import numpy as np

    from models.data.motions import read_motions

    with h5py.File(folder / "runs.hdf5", "w") as file:
        file["data/demo_0/obs/state"], file["data/demo_0/actions"] = np.zeros((2, 1)), np.zeros((2, 1))
    return ".hdf5", lambda path: read_motions(path, ["state"]), [(folder / "runs.hdf5").read_bytes()]


READERS: dict[str, Callable[[Path], Reader]] = {
    "scenario": _scenario, "detector": _detector, "network": _network, "record": _record, "rows": _rows,
    "motions": _motions,
}  # fmt: skip


def judged(read: Callable[[Path], object], path: Path) -> str:
    """What is wrong with the answer of `read` to the file `path`; empty: nothing."""
    try:
        read(path)
    except InputError as error:
        return "" if REMEDY.search(str(error)) else f"names no remedy: {error}"
    except MemoryError:  # which the programs answer, see models.command_line.run
        return ""
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def in_a_process(name: str, arguments: FuzzBytesArguments) -> tuple[int, list[str]]:
    """How many inputs the reader answered well, and what it did not; a process of its own, which Atheris ends."""
    context = multiprocessing.get_context("fork")  # nothing of the project but the command line is loaded yet
    well, said = context.Value("q", 0, lock=False), context.SimpleQueue()
    kept = arguments.out / str(arguments.seed) / name
    kept.mkdir(parents=True, exist_ok=True)
    process = context.Process(target=_guided, args=(name, arguments, kept, well, said))
    process.start()
    wrong = []
    while process.is_alive() or not said.empty():
        process.join(0.05)
        while not said.empty():
            wrong.append(said.get())
    if process.exitcode:
        wrong.append(f"its process ended with {process.exitcode}: see {kept}")
    return well.value, wrong


def _guided(name: str, arguments: FuzzBytesArguments, kept: Path, well, said) -> None:
    import atheris

    seen: set[str] = set()
    with tempfile.TemporaryDirectory() as folder, (kept / "log.txt").open("wb") as log:
        os.dup2(log.fileno(), 2)  # where Atheris tells what it does
        with atheris.instrument_imports(include=["diagrams", "models", "yaml", "safetensors", "zipfile"]):
            suffix, read, begun = READERS[name](Path(folder))
        path, corpus = Path(folder) / f"input{suffix}", Path(folder) / "corpus"
        corpus.mkdir()
        for i, content in enumerate(begun):
            (corpus / str(i)).write_bytes(content)

        def one(content: bytes) -> None:
            path.write_bytes(content)
            if wrong := judged(read, path):
                where = kept / hashlib.sha256(content).hexdigest()[:16]
                where.write_bytes(content)
                if (kind := wrong[:60]) not in seen:  # each kind once
                    seen.add(kind)
                    said.put(f"{where}: {wrong[:200]}")
            else:
                well.value += 1

        options = {
            "seed": arguments.seed + 1, "runs": arguments.count, "max_len": LARGEST, "timeout": SECONDS,
            "rss_limit_mb": MEBIBYTES, "artifact_prefix": f"{kept}/",
        }  # fmt: skip
        atheris.Setup([name, *(f"-{key}={value}" for key, value in options.items()), str(corpus)], one)
        atheris.Fuzz()


def _sources() -> str:
    from diagrams.episodes.fingerprint import code_hash

    return code_hash("tests/campaigns")


def main(arguments: FuzzBytesArguments) -> int:
    """Runs the readers that are not done; returns the exit code."""
    require_numbers(arguments, {"seed": (0, LARGEST_SEED), "count": (1, 10**9)})
    for name in arguments.readers:
        if name not in READERS:
            raise InputError(f"there is no reader '{name}': choose from {', '.join(READERS)}")
    if importlib.util.find_spec("atheris") is None:
        raise InputError("Atheris is not installed: pip install atheris, which has wheels for Linux")
    names = arguments.readers or [*READERS]
    with multiprocessing.get_context("fork").Pool(1) as other:  # what is loaded here is not instrumented any more
        code = other.apply(_sources)
    done, total = 0, 0
    for name in names:
        result = arguments.out / str(arguments.seed) / f"{name}-{arguments.count}-{code}.json"
        if not result.is_file():
            answered, wrong = in_a_process(name, arguments)
            result.write_text(json.dumps([answered, wrong]))
        answered, wrong = json.loads(result.read_text())
        print(f"{name}: {answered} of {arguments.count} answered well", *wrong[:SHOWN], sep="\n  ", flush=True)
        done, total = done + min(answered, arguments.count), total + arguments.count
    print(f"{done} of {total} answered well")
    return 0 if done == total else 1


def parse(words: list[str] | None = None) -> FuzzBytesArguments:
    """The command line."""
    return tyro.cli(FuzzBytesArguments, args=words, description=__doc__)


if __name__ == "__main__":
    run(main, parse)
