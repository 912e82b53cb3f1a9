"""The pages say what is so: their commands parse, their options and files exist. `tests/pages.sh` runs the commands."""

import contextlib
import functools
import importlib
import io
import itertools
import re
import shlex

import pytest

from diagrams.analysis import ANALYSES
from diagrams.bench import OTHERS
from models.command_line import ROOT
from models.training.__main__ import commands as training_commands

ROOMS = ("sdf", "models", "systems", "diagrams", "tests")
PAGES = sorted(
    [ROOT / "README.md", *(page for room in ROOT.iterdir() if room.name in ROOMS for page in room.rglob("*.md"))]
)
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
# The programs with commands, which may take options alone too; every other program does.
SUBCOMMANDS = {"diagrams.analysis": tuple(ANALYSES), "models.training.__main__": tuple(training_commands())}
SUBCOMMANDS |= {"diagrams.bench": tuple(OTHERS)}
CAMPAIGNS = tuple(
    f"tests.campaigns.{path.stem}" for path in ROOT.glob("tests/campaigns/*.py") if "def parse(" in path.read_text()
)
PROGRAMS = (
    *(f"diagrams.{path.stem}" for path in ROOT.glob("diagrams/[a-z]*.py")), "models.training.__main__", *CAMPAIGNS,
)  # fmt: skip
FOREIGN = {"--measure", "--index-url", "--help", "--host", "--no-dashboard"}  # pytest, pip, everybody, Dask


def commands(text):
    """The commands of the ```sh blocks, a list of words each, without what connects them."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines() if line.strip()]
    return [words for line in lines for part in re.split("&&?|;", line) if (words := shlex.split(part, comments=True))]


def program(words):
    """The module that a command starts, and its arguments; (None, []) for a command that is none of ours."""
    for i, word in enumerate(words[:-1]):
        if word in ("python", "python3"):
            if words[i + 1] == "-m":
                return (f"{words[i + 2]}.__main__", words[i + 3 :]) if words[i + 2].startswith("models") else (None, [])
            return words[i + 1].removesuffix(".py").replace("/", "."), words[i + 2 :]
    return None, []


@functools.cache
def options(module, *command):
    """Every option in the help of a program, or of one command of it."""
    text = io.StringIO()
    parse = importlib.import_module(module).parse
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(text):
        patch.setenv("COLUMNS", "200")
        with pytest.raises(SystemExit) as end:
            parse([*command, "--help"])
    assert end.value.code == 0
    return set(re.findall(r"--[a-z][\w.-]*", text.getvalue()))


def of_program(module):
    """The options of a program with those of its commands."""
    return options(module).union(*(options(module, command) for command in SUBCOMMANDS.get(module, ())))


OURS = [
    pytest.param(*program(words), id=f"{name}: {' '.join(words)}"[:150])
    for name, page in zip(NAMES, PAGES, strict=True)
    for words in commands(page.read_text())
    if program(words)[0]
]


def test_pages_are_found_and_have_commands():
    assert {"README.md", "diagrams/RESULTS.md", "diagrams/ANALYSIS.md", "models/README.md"} <= set(NAMES)
    assert len(OURS) > 20
    assert {module for module, _ in (case.values for case in OURS)} == set(PROGRAMS)


@pytest.mark.parametrize(("module", "arguments"), OURS)
def test_command_parses(module, arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for option, word in itertools.pairwise(arguments):
        if word.endswith(".yaml"):
            (tmp_path / word).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / word).write_text("resumption: reset\n" if option == "--world" else "seed: 0\n")
    message = io.StringIO()
    try:
        with contextlib.redirect_stderr(message), contextlib.redirect_stdout(message):
            importlib.import_module(module).parse(arguments)
    except SystemExit:
        pytest.fail(f"{module} does not take {' '.join(arguments)}:\n{message.getvalue()}")


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_options_in_the_text_exist(page):
    """Also those between the commands: `--option`, `sweep.py --option`, `modes --option`."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    everything = set().union(FOREIGN, *map(of_program, PROGRAMS))
    for span in re.findall(r"`([^`]*)`", text.replace("\n", " ")):
        named = [module for module in PROGRAMS if f"{module.split('.')[-1]}.py" in span or f"{module[:15]} " in span]
        known = of_program(named[0]) | FOREIGN if named else everything
        for module, names in SUBCOMMANDS.items():
            for command in names:
                if f" {command} --" in f" {span}" and (not named or named[0] == module):
                    known = options(module, command)
        unknown = {option.rstrip(".") for option in re.findall(r"(?<![\w-])--[a-z][\w.-]*", span)} - known
        assert not unknown, f"`{span}`"


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_and_paths_exist(page):
    text = page.read_text()
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]+))?\)", text):
        if target.startswith("http"):
            continue
        path = page.parent / target if target else page
        assert path.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
            slugs = [re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings]
            assert anchor in slugs, f"{target}#{anchor}"
    for path in re.findall(r"`([\w./-]+)`", text):
        assert path.split("/")[0] not in (*ROOMS, ".ci") or (ROOT / path).exists(), path


def test_front_page_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_lines_are_short(page):
    """Tables and pictures aside, which Markdown does not break."""
    lines = [line for line in page.read_text().splitlines() if not line.startswith(("|", "!["))]
    assert [line for line in lines if len(line) > 120] == []


def test_ci_runs_the_test_command_of_the_front_page():
    script = (ROOT / ".ci" / "run").read_text()
    words = [w for w in commands((ROOT / "README.md").read_text()) if w[0] in ("ruff", "mypy", "pytest")]
    assert [w[0] for w in words] == ["ruff", "ruff", "mypy", "pytest"]
    for command in words:
        assert " ".join(command) in script
    assert "'.[dev]'" in script


def test_every_weight_file_has_its_card():
    from models.files.container import file_hash

    weights = ROOT / "models" / "weights"
    card = (weights / "README.md").read_text()
    files = [path for path in weights.rglob("*") if path.is_file() and path.suffix != ".md"]
    networks = {f"{name}{seed}" for name in ("lstm", "gru", "mtrnn") for seed in ("", "-1", "-2")}
    onnx = {str(file.relative_to(weights).with_suffix("")) for file in files if file.suffix == ".onnx"}
    assert onnx == {"encoder", "decoder", "iiwa/encoder", "iiwa/lstm", *networks}
    for file in files:
        row = next(line for line in card.splitlines() if line.startswith(f"| `{file.relative_to(weights)}`"))
        assert f"| {file_hash(file)[:12]} |" in row
        assert f"| {file.stat().st_size:,} |" in row
