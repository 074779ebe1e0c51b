"""The house rules: a file imports only from floors below its own, stays short, and baselines hang on, never hold up."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "idrgbdo_torch"
FILES = sorted(PACKAGE.rglob("*.py"))
LONGEST = 300  # lines

# from the ground up; a folder counts as one, and its files may import each other
FLOORS = (
    {"errors"},
    {"text"},
    {"config"},
    {"measurement"},  # what a point, a patch and its noise are
    {"definitions", "kernels"},  # the method twice, side by side
    {"frame", "trajectory"},
    {"odometry", "evaluation"},
    {"tracker"},
    {"datasets", "synthetic", "download"},
    {"runs"},
    {"comparison"},
    {"export"},
    {"report"},
    {"check"},
    {"experiments"},
    {"commands"},
    {"__main__", "__init__"},
)
FLOOR = {name: floor for floor, names in enumerate(FLOORS) for name in names}
MAY_USE_BASELINES = {"commands", "experiments"}


def module(path: Path) -> tuple[str, ...]:
    """The parts of a file's name inside the package: ("datasets", "tum")."""
    return path.relative_to(PACKAGE).with_suffix("").parts


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Everything that runs: all nodes but those under `if TYPE_CHECKING:`."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        yield node
        yield from statements(node)


def imported_units(path: Path) -> set[str]:
    """The files or folders directly in the package that a file imports, relatively or by the package's name."""
    units: set[str] = set()
    folder = module(path)[:-1]
    for node in statements(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            parts = tuple((node.module or "").split(".")) if node.module else ()
            if node.level:
                parts = folder[: len(folder) - node.level + 1] + parts
            elif parts[:1] == (PACKAGE.name,):
                parts = parts[1:]
            else:
                continue
            units |= {parts[0]} if parts else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
            units |= {name[1] for name in names if name[0] == PACKAGE.name and len(name) > 1}
    return units & {module(file)[0] for file in FILES}


@pytest.mark.parametrize("path", FILES, ids=lambda path: "/".join(module(path)))
def test_a_file_imports_only_from_floors_below(path: Path) -> None:
    own = module(path)[0]
    assert own in FLOOR, f"say in FLOORS where {own} stands"
    wrong = sorted(unit for unit in imported_units(path) if unit != own and FLOOR[unit] >= FLOOR[own])
    assert not wrong, f"{own} (floor {FLOOR[own]}) imports {wrong} from its own floor or above"


@pytest.mark.parametrize("path", FILES, ids=lambda path: "/".join(module(path)))
def test_only_the_doors_know_the_baselines_and_only_when_asked(path: Path) -> None:
    tree = ast.parse(path.read_text())
    own = module(path)[0]
    for node in statements(tree):
        called = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""
        if called in ("shipped_methods", "shipped_folder"):
            assert own in MAY_USE_BASELINES, f"line {node.lineno} asks for the baselines"
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        if any(name.split(".")[0] == "baselines" for name in names):
            raise AssertionError(f"line {node.lineno} imports baselines; comparison/shipped.py does")


def test_no_file_is_long() -> None:
    counts = {
        path: len(path.read_text().splitlines()) for path in [*FILES, *sorted((ROOT / "baselines").rglob("*.py"))]
    }
    long = {str(path.relative_to(ROOT)): count for path, count in counts.items() if count > LONGEST}
    assert not long, f"split {long}"


def test_the_library_neither_prints_nor_exits_nor_swallows() -> None:
    for path in FILES:
        shown = module(path)[0] in ("commands", "__main__") or module(path) == ("report", "terminal")
        for node in ast.walk(ast.parse(path.read_text())):
            where = f"{path.relative_to(ROOT)}, line {getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not shown:
                assert node.func.id != "print", where
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                assert (ast.unparse(node.func) != "sys.exit") or shown, where
                assert node.func.attr != "set_num_threads", where
            if isinstance(node, ast.ExceptHandler):
                assert node.type is not None, where
                assert ast.unparse(node.type) not in ("Exception", "BaseException"), where
