"""The rooms: who imports whom, read from the sources; no circle, no program imported, no room too large."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from models.command_line import ROOT

PACKAGES = ("models", "systems", "diagrams")
# A room may import those before it, and itself.
FLOORS = (
    {"models"},
    {"systems"},
    {"diagrams.world"},
    {"diagrams.episodes"},
    {"diagrams.drawing"},
    {"diagrams.hybrid", "diagrams.sweeps", "diagrams.browser"},
    {"diagrams.monitors"},
    {"programs"},
)
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in FILES}


def imports_of(path: Path) -> set[str]:
    """Modules of ours that the file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return found & MODULES.keys()


def room_of(module: str) -> str:
    parts = module.split(".")
    if parts[0] != "diagrams":
        return parts[0]
    return ".".join(parts[:2]) if MODULES[module].parent != ROOT / "diagrams" else "programs"


def floor_of(module: str) -> int:
    return next(n for n, rooms in enumerate(FLOORS) if room_of(module) in rooms)


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_down(module):
    for other in imports_of(MODULES[module]):
        if other == "diagrams":
            continue
        same = room_of(other) == room_of(module)
        assert room_of(other) != "programs", f"{module} imports the program {other}"
        assert floor_of(other) < floor_of(module) or same, f"{module} imports {other}"


def test_models_and_systems_know_no_task():
    drake = {path for name, path in MODULES.items() if name.startswith("models") and "pydrake" in path.read_text()}
    assert not drake
    for name, path in MODULES.items():
        if name.startswith("systems"):
            names = {node.id for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Name)}
            assert not names & {"CANS", "SPOTS", "ARM_JOINTS"}, name


def test_there_is_no_circle():
    graph = {module: imports_of(path) - {module} for module, path in MODULES.items()}
    assert len(list(TopologicalSorter(graph).static_order())) == len(MODULES)


def test_only_programs_lie_at_the_top_of_diagrams():
    top = [path for path in (ROOT / "diagrams").glob("*.py") if path.name != "__init__.py"]
    assert len(top) >= 7
    for path in top:
        assert '__name__ == "__main__"' in path.read_text(), path.name
        assert not (path.with_suffix("")).exists(), f"a package has the name of the program {path.name}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_file_is_too_large(path):
    assert len(path.read_text().splitlines()) < 350


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_module_exits_when_it_is_imported(path):
    """sys.exit only inside functions, or below `if __name__`."""
    tree = ast.parse(path.read_text())
    top = [node for node in tree.body if not isinstance(node, ast.FunctionDef | ast.ClassDef)]
    top = [n for n in top if not (isinstance(n, ast.If) and "__name__" in ast.unparse(n.test))]
    assert "sys.exit" not in "\n".join(ast.unparse(node) for node in top)


def test_the_tests_mirror_the_rooms():
    for folder in (ROOT / "tests").rglob("*"):
        if folder.is_dir() and folder.name not in ("__pycache__", "benchmarks", "campaigns"):
            assert (ROOT / folder.relative_to(ROOT / "tests")).is_dir(), folder
